//! Voxel centres of a block in the lattice of another field.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use crate::atlas::fusion::alignment::CubeOffset;
use crate::atlas::fusion::placement::floor;
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, block_coords, edge_at, voxels_at};
use crate::simd::{Kernel, dispatch, floor_positive};

/// Voxels of a block at the finest scale.
const CAPACITY: usize = voxels_at(0);

/// Centres of a block's voxels as coordinates in another lattice, both at one scale; by axis, then by voxel.
pub(crate) struct SampleGrid {
    /// The last voxel along the axis whose centre is not beyond the point.
    pub base: [[i32; CAPACITY]; 3],
    /// Distance of the point beyond that centre, 0 to 1 voxels.
    fraction: [[f32; CAPACITY]; 3],
}

impl SampleGrid {
    /// An uninitialised grid; call [`fill`](Self::fill) before reading.
    pub fn new() -> Self {
        Self { base: [[0; CAPACITY]; 3], fraction: [[0.0; CAPACITY]; 3] }
    }

    /// Computes the centres of block `key` at `scale`; `t` maps finest voxels to finest voxels, and `offset` is added to the result.
    pub fn fill(&mut self, t: &Rigid, offset: &CubeOffset, key: u64, scale: usize) {
        let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        dispatch(Fill { t, offset: &offset.within(corner, BLOCK_EDGE as f32), corner, scale, grid: self });
    }

    /// Base voxel and fraction of centre `i`.
    #[inline(always)]
    pub fn at(&self, i: usize) -> ([i32; 3], [f32; 3]) {
        (self.base.each_ref().map(|base| base[i]), self.fraction.each_ref().map(|fraction| fraction[i]))
    }
}

/// Base voxel and fraction of a point, given in finest voxels of the other lattice, among voxels of `scale`.
#[inline(always)]
pub(crate) fn base_and_fraction(point: [f32; 3], scale: usize) -> ([i32; 3], [f32; 3]) {
    let at = point.map(|v| v / (1 << scale) as f32 - 0.5);
    let base = at.map(floor);
    (base, std::array::from_fn(|k| at[k] - base[k] as f32))
}

struct Fill<'a> {
    t: &'a Rigid,
    /// Between the corners of the block.
    offset: &'a CubeOffset,
    corner: [f32; 3],
    scale: usize,
    grid: &'a mut SampleGrid,
}

impl Kernel for Fill<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { t, offset, corner, scale, grid } = self;
        let n = edge_at(scale);
        let edge = (1 << scale) as f32;
        // Below all coordinates of the block: from there on they are small and positive, which makes rounding cheap.
        let middle = t.apply(corner.map(|c| c + 0.5 * BLOCK_EDGE as f32));
        let (mean, spread) = offset.mean_and_spread();
        let low: [i32; 3] = std::array::from_fn(|k| floor((middle[k] + mean[k] - spread - BLOCK_EDGE as f32) / edge) - 2);
        let (share, is_moved) = (|i: usize| (i as f32 + 0.5) / n as f32, offset.corners != [[0.0; 3]; 8]);
        for z in 0..n {
            for y in 0..n {
                let row = n * (y + n * z);
                let first = t.apply([corner[0] + 0.5 * edge, corner[1] + (y as f32 + 0.5) * edge, corner[2] + (z as f32 + 0.5) * edge]);
                let first = first.map(|v| v / edge - 0.5);
                // The offset is linear along a row, between its values at the two ends.
                let (v, w) = (share(y), share(z));
                for k in 0..3 {
                    let end = |x: usize| {
                        let at = |y: usize, z: usize| offset.corners[x | y << 1 | z << 2][k];
                        (at(0, 0) * (1.0 - v) + at(1, 0) * v) * (1.0 - w) + (at(0, 1) * (1.0 - v) + at(1, 1) * v) * w
                    };
                    let (start, slope) = if is_moved { (end(0) / edge, (end(1) - end(0)) / BLOCK_EDGE as f32) } else { (0.0, 0.0) };
                    let (first, step) = (first[k] + (start + 0.5 * slope), t.rotation[k][0] + slope);
                    let (base, fraction) = (&mut grid.base[k][row..row + n], &mut grid.fraction[k][row..row + n]);
                    for x in 0..n {
                        let at = first + x as f32 * step;
                        let whole = floor_positive(at - low[k] as f32);
                        base[x] = whole + low[k];
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
        fn the_grid_of_a_block_equals_its_voxels_one_by_one(
            block in prop::array::uniform3(-50i32..50), angles in prop::array::uniform3(-3f64..3.0), shift in prop::array::uniform3(-99f64..99.0), scale in 0usize..4,
        ) {
            let turn = nalgebra::UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
            let t = Rigid::from(&crate::Pose::from_parts(nalgebra::Translation3::new(shift[0], shift[1], shift[2]), turn));
            let mut grid = SampleGrid::new();
            grid.fill(&t, &CubeOffset::default(), block_key(block), scale);
            for i in 0..voxels_at(scale) {
                let c = voxel_coords(i, scale);
                let centre = std::array::from_fn(|k| (block[k] * 8) as f32 + (c[k] as f32 + 0.5) * (1 << scale) as f32);
                let ((base, fraction), (expected, beyond)) = (grid.at(i), base_and_fraction(t.apply(centre), scale));
                for k in 0..3 {
                    prop_assert!((0.0..=1.0).contains(&fraction[k]));
                    prop_assert!((base[k] as f32 + fraction[k] - expected[k] as f32 - beyond[k]).abs() < 2e-3);
                }
            }
        }
    }
}
