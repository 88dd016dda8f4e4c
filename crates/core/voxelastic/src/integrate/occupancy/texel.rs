//! Texels: the range interval of a pixel or of a part of the image, in four bytes.

use crate::simd::floor_positive;
use crate::simd::{larger, smaller};

/// Nearest and farthest range of a pixel, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub(super) struct Texel {
    pub near: f32,
    pub far: f32,
}

/// A texel in four bytes: near rounded down in the lowest 15 bits, far rounded up in the next 15, both in steps of the pyramid; then a bit each for "contains a
/// pixel without return" and "extends beyond the field of view".
pub(super) type Packed = u32;

const FIELD: Packed = 0x7fff;
const FAR_SHIFT: u32 = 15;
/// A pixel within the field of view has no return.
pub(super) const HOLE_BIT: Packed = 1 << 30;
/// A part is outside of the field of view.
pub(super) const RIM_BIT: Packed = 1 << 31;

/// Nearest range of the pixels with a return, in steps; beyond the maximum range if there is none.
#[inline(always)]
pub(super) fn near_of(texel: Packed) -> f32 {
    (texel & FIELD) as i32 as f32
}

/// Farthest range of the pixels with a return, in steps; 0 if there is none.
#[inline(always)]
pub(super) fn far_of(texel: Packed) -> f32 {
    (texel >> FAR_SHIFT & FIELD) as i32 as f32
}

/// Outside of the field of view.
pub(super) const OUTSIDE: Packed = RIM_BIT | FIELD;
/// A pixel without return.
const HOLE: Packed = HOLE_BIT | FIELD;

/// The union of two texels.
#[inline(always)]
pub(super) fn join(a: Packed, b: Packed) -> Packed {
    let (near_a, near_b) = (a & FIELD, b & FIELD);
    let (far_a, far_b) = (a & FIELD << FAR_SHIFT, b & FIELD << FAR_SHIFT);
    let near = if near_a < near_b { near_a } else { near_b };
    let far = if far_a > far_b { far_a } else { far_b };
    (a | b) & (HOLE_BIT | RIM_BIT) | far | near
}

/// A pixel in steps; its range interval is within the packed one.
#[inline(always)]
pub(super) fn pack(pixel: &Texel, per_metre: f32) -> Packed {
    // The products' rounding must not push a bound inwards.
    let near = pixel.near * per_metre * (1.0 - 2.0 * f32::EPSILON);
    let far = pixel.far * per_metre * (1.0 + 2.0 * f32::EPSILON);
    // Rounded up; a whole number stays.
    let (near, below) = (floor_positive(smaller(near, FIELD as f32)), floor_positive(larger(far, 0.0)));
    let far = below + i32::from((below as f32) < far);
    let packed = (far as u32) << FAR_SHIFT | near as u32;
    if pixel.far < 0.0 { HOLE } else { packed }
}

/// Windows of 2 x 2 cells from two rows of cells, which are closed circles.
#[inline(always)]
pub(super) fn join_rows(upper: &[Packed], lower: &[Packed], windows: &mut [Packed]) {
    let last = windows.len() - 1;
    let left = upper[..last].iter().zip(&lower[..last]);
    let right = upper[1..=last].iter().zip(&lower[1..=last]);
    for (window, ((&a, &b), (&c, &d))) in windows.iter_mut().zip(left.zip(right)) {
        *window = join(join(a, b), join(c, d));
    }
    windows[last] = join(join(upper[last], lower[last]), join(upper[0], lower[0]));
}

/// Cells of twice the size from two rows of cells.
#[inline(always)]
pub(super) fn halve(upper: &[Packed], lower: &[Packed], cells: &mut [Packed]) {
    let (upper, lower) = (upper.as_chunks::<2>().0, lower.as_chunks::<2>().0);
    for (cell, (&[a, b], &[c, d])) in cells.iter_mut().zip(upper.iter().zip(lower)) {
        *cell = join(join(a, b), join(c, d));
    }
}
