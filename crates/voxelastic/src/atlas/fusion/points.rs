//! Where the voxels of a block lie in another field's lattice.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::floor;
use crate::dispatch::{Kernel, dispatch};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, block_coords, edge_at, voxels_at};

/// Room for the voxels of a block at the finest scale.
const ROOM: usize = voxels_at(0);

/// Centres of the voxels of a block as places in another lattice, both with voxels of one scale; by axis, then by voxel.
pub(super) struct Points {
    /// The voxel whose centre is the last one before the point.
    base: [[i32; ROOM]; 3],
    /// How far beyond that centre the point is, 0 to 1 voxels.
    fraction: [[f32; ROOM]; 3],
}

impl Points {
    /// Room for a block's.
    pub fn new() -> Self {
        Self { base: [[0; ROOM]; 3], fraction: [[0.0; ROOM]; 3] }
    }

    /// Those of block `key` at `scale`; `t` is in finest voxels.
    pub fn place(&mut self, t: &Rigid, key: u64, scale: usize) {
        dispatch(Place { t, corner: block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32), scale, points: self });
    }

    /// The voxel before point `i`, and how far it lies beyond it.
    #[inline(always)]
    pub fn at(&self, i: usize) -> ([i32; 3], [f32; 3]) {
        (self.base.each_ref().map(|base| base[i]), self.fraction.each_ref().map(|fraction| fraction[i]))
    }
}

/// The same for a single point, finest voxels of the other lattice.
#[inline(always)]
pub(super) fn between(point: [f32; 3], scale: usize) -> ([i32; 3], [f32; 3]) {
    let at = point.map(|v| v / (1 << scale) as f32 - 0.5);
    let base = at.map(floor);
    (base, std::array::from_fn(|k| at[k] - base[k] as f32))
}

struct Place<'a> {
    t: &'a Rigid,
    corner: [f32; 3],
    scale: usize,
    points: &'a mut Points,
}

impl Kernel for Place<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { t, corner, scale, points } = self;
        let n = edge_at(scale);
        let edge = (1 << scale) as f32;
        for z in 0..n {
            for y in 0..n {
                let row = n * (y + n * z);
                let first = t.apply([corner[0] + 0.5 * edge, corner[1] + (y as f32 + 0.5) * edge, corner[2] + (z as f32 + 0.5) * edge]);
                let first = first.map(|v| v / edge - 0.5);
                for k in 0..3 {
                    let (base, fraction) = (&mut points.base[k][row..row + n], &mut points.fraction[k][row..row + n]);
                    for x in 0..n {
                        let at = first[k] + x as f32 * t.rotation[k][0];
                        base[x] = floor(at);
                        fraction[x] = at - base[x] as f32;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{block_key, voxel_coords};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn points_of_a_block_are_those_of_its_voxels(
            home in prop::array::uniform3(-50i32..50), angles in prop::array::uniform3(-3f64..3.0), shift in prop::array::uniform3(-99f64..99.0), scale in 0usize..4,
        ) {
            let turn = nalgebra::UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
            let t = Rigid::from(&crate::Pose::from_parts(nalgebra::Translation3::new(shift[0], shift[1], shift[2]), turn));
            let mut points = Points::new();
            points.place(&t, block_key(home), scale);
            for i in 0..voxels_at(scale) {
                let c = voxel_coords(i, scale);
                let centre = std::array::from_fn(|k| (home[k] * 8) as f32 + (c[k] as f32 + 0.5) * (1 << scale) as f32);
                let ((base, fraction), (expected, beyond)) = (points.at(i), between(t.apply(centre), scale));
                for k in 0..3 {
                    prop_assert!((0.0..=1.0).contains(&fraction[k]));
                    prop_assert!((base[k] as f32 + fraction[k] - expected[k] as f32 - beyond[k]).abs() < 2e-3);
                }
            }
        }
    }
}
