//! The source's voxels as a fusion samples them: plain arrays, no finer than asked for, made when the first voxel of one is.

use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::{SCALES, edge_at, voxel_coords};
use crate::surface::view::{settle, shade_at};
use std::cell::OnceCell;

/// Edge of a block in voxels, as [`Seen::is_near_any`] counts them.
const EDGE: usize = edge_at(0);

/// The voxels of a block at one scale.
#[derive(Clone)]
struct SeenBlock {
    voxels: Box<[Voxel]>,
    /// Bit x + 8 y of layer z: whether any of the eight voxels from x, y, z on in the block is observed.
    near_any: [u64; EDGE],
}

impl SeenBlock {
    fn new(voxels: Box<[Voxel]>, scale: usize) -> Self {
        let mut layers = [0u64; EDGE + 1];
        for (i, voxel) in voxels.iter().enumerate() {
            let [x, y, z] = voxel_coords(i, scale);
            layers[z] |= u64::from(voxel.is_observed()) << (x + EDGE * y);
        }
        // Bits that come from the next row are of cells that reach beyond the block, about which nobody asks.
        let near_any = std::array::from_fn(|z| {
            let rows = layers[z] | layers[z + 1];
            let pairs = rows | rows >> 1;
            pairs | pairs >> EDGE
        });
        Self { voxels, near_any }
    }
}

/// Some blocks of a field. Each is called by its place among them.
pub(super) struct Seen<'a> {
    field: &'a TsdfField,
    ids: Vec<u32>,
    /// The finest scale of each.
    finest: Vec<u8>,
    /// By scale, then by place.
    blocks: [Vec<OnceCell<SeenBlock>>; SCALES],
}

impl<'a> Seen<'a> {
    /// The blocks `ids` of `field`.
    pub fn new(field: &'a TsdfField, ids: Vec<u32>) -> Self {
        let finest = ids.iter().map(|&id| field.block(id).finest).collect();
        let blocks = std::array::from_fn(|_| vec![OnceCell::new(); ids.len()]);
        Self { field, ids, finest, blocks }
    }

    /// Whether the block at `place` has anything as fine as `scale`.
    #[inline(always)]
    pub fn is_seen_at(&self, place: u32, scale: usize) -> bool {
        usize::from(self.finest[place as usize]) <= scale
    }

    /// The voxels of the block at `place`, which [is seen](Self::is_seen_at) at `scale`: where it is finer, means.
    #[inline(always)]
    pub fn voxels(&self, place: u32, scale: usize) -> &[Voxel] {
        &self.block(place, scale).voxels
    }

    /// Whether any of the eight voxels from `c` on, all in the block at `place`, is observed.
    #[inline(always)]
    pub fn is_near_any(&self, place: u32, scale: usize, c: [usize; 3]) -> bool {
        self.block(place, scale).near_any[c[2]] >> (c[0] + EDGE * c[1]) & 1 == 1
    }

    #[inline(always)]
    fn block(&self, place: u32, scale: usize) -> &SeenBlock {
        self.blocks[scale][place as usize].get_or_init(|| {
            let id = self.ids[place as usize];
            let voxels = settle(self.field, id, scale).1.unwrap_or_else(|| self.field.current(self.field.block(id)).into());
            SeenBlock::new(voxels, scale)
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
