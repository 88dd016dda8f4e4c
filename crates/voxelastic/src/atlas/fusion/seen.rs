//! The source's voxels as a fusion samples them: plain arrays, no finer than asked for, made when the first voxel of one is.

use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::{SCALES, voxel_coords};
use crate::surface::view::{settle, shade_at};
use std::cell::OnceCell;

/// Some blocks of a field. Each is called by its place among them.
pub(super) struct Seen<'a> {
    field: &'a TsdfField,
    ids: Vec<u32>,
    /// The finest scale of each.
    finest: Vec<u8>,
    /// By scale, then by place.
    arrays: [Vec<OnceCell<Box<[Voxel]>>>; SCALES],
}

impl<'a> Seen<'a> {
    /// The blocks `ids` of `field`.
    pub fn new(field: &'a TsdfField, ids: Vec<u32>) -> Self {
        let finest = ids.iter().map(|&id| field.block(id).finest).collect();
        let arrays = std::array::from_fn(|_| vec![OnceCell::new(); ids.len()]);
        Self { field, ids, finest, arrays }
    }

    /// Whether the block at `place` has anything as fine as `scale`.
    #[inline(always)]
    pub fn is_seen_at(&self, place: u32, scale: usize) -> bool {
        usize::from(self.finest[place as usize]) <= scale
    }

    /// The voxels of the block at `place`, which [is seen](Self::is_seen_at) at `scale`: where it is finer, means.
    #[inline(always)]
    pub fn voxels(&self, place: u32, scale: usize) -> &[Voxel] {
        self.arrays[scale][place as usize].get_or_init(|| {
            let id = self.ids[place as usize];
            settle(self.field, id, scale).1.unwrap_or_else(|| self.field.current(self.field.block(id)).into())
        })
    }

    /// Intensity at voxel `index` of the block at `place` as seen at `scale`, if it is known: where it is known finer, the mean of that.
    pub fn shade(&self, place: u32, scale: usize, index: usize) -> Option<u8> {
        let block = self.field.block(self.ids[place as usize]);
        if !self.field.is_shaded(block) {
            return None;
        }
        let shade = shade_at(voxel_coords(index, scale), scale, usize::from(block.scale), |i| self.field.shade(block, i));
        (shade > 0).then_some(shade)
    }
}
