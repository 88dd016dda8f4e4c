//! Occupancy of the source at the voxels of a block of the target: places in vector lanes, then values one by one.

use super::placement::Placement;
use crate::field::occupancy::OccupancyWindow;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, block_coords};
use crate::simd::{Kernel, dispatch};

/// Voxels whose places are computed together.
const LANES: usize = 16;

/// Looks up the values at the voxels of block `key` of the target, at `scale`, in a window on the source.
pub(super) fn look_up(window: &OccupancyWindow<'_>, placement: &Placement, key: u64, scale: usize, values: &mut [i8]) {
    dispatch(LookUp { window, placement, key, scale, values });
}

struct LookUp<'a, 'w> {
    window: &'a OccupancyWindow<'w>,
    placement: &'a Placement,
    key: u64,
    scale: usize,
    values: &'a mut [i8],
}

impl Kernel for LookUp<'_, '_> {
    #[inline(always)]
    fn run(self) {
        let Self { window, placement, key, scale, values } = self;
        let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let edge = (1 << scale) as f32;
        let shift = BLOCK_SHIFT - scale as u32;
        let mask = (BLOCK_EDGE as u32 >> scale) - 1;
        for (chunk, values) in values.chunks_mut(LANES).enumerate() {
            let mut places = [0; LANES];
            for (lane, place) in places.iter_mut().enumerate() {
                let i = (chunk * LANES + lane) as u32;
                let c = [i & mask, i >> shift & mask, i >> (2 * shift) & mask];
                let centre = std::array::from_fn(|k| corner[k] + (c[k] as i32 as f32 + 0.5) * edge);
                *place = window.place(placement.t_source_target.apply(centre));
            }
            for (value, place) in values.iter_mut().zip(places) {
                *value = window.value_at(place);
            }
        }
    }
}
