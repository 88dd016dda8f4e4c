//! Cache of the source's blocks: arrays at the requested scale, made on first access.

use crate::field::tsdf::resolve::{intensity_at, resolve_block};
use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::{SCALES, edge_at, voxel_coords};
use std::cell::OnceCell;

/// Edge of a block in finest voxels.
const EDGE: usize = edge_at(0);

/// A block's voxels at one scale.
#[derive(Clone)]
struct CachedBlock {
    voxels: Box<[Voxel]>,
    /// Bit x + 8 y of layer z: whether any of the eight voxels of the cell at (x, y, z) is observed.
    observed_cells: [u64; EDGE],
}

impl CachedBlock {
    fn new(voxels: Box<[Voxel]>, scale: usize) -> Self {
        let mut layers = [0u64; EDGE + 1];
        for (i, voxel) in voxels.iter().enumerate() {
            let [x, y, z] = voxel_coords(i, scale);
            layers[z] |= u64::from(voxel.is_observed()) << (x + EDGE * y);
        }
        // Bits shifted in from the next row belong to cells that extend beyond the block; these are not read.
        let observed_cells = std::array::from_fn(|z| {
            let rows = layers[z] | layers[z + 1];
            let pairs = rows | rows >> 1;
            pairs | pairs >> EDGE
        });
        Self { voxels, observed_cells }
    }
}

/// Some blocks of a field, addressed by their index among them.
pub(super) struct BlockCache<'a> {
    field: &'a TsdfField,
    ids: Vec<u32>,
    /// The finest scale of each.
    finest: Vec<u8>,
    /// By scale, then by index.
    blocks: [Vec<OnceCell<CachedBlock>>; SCALES],
}

impl<'a> BlockCache<'a> {
    /// A cache of the blocks `ids` of `field`.
    pub fn new(field: &'a TsdfField, ids: Vec<u32>) -> Self {
        let finest = ids.iter().map(|&id| field.block(id).finest).collect();
        let blocks = std::array::from_fn(|_| vec![OnceCell::new(); ids.len()]);
        Self { field, ids, finest, blocks }
    }

    /// Whether block `block` holds voxels as fine as `scale`.
    #[inline(always)]
    pub fn is_resolved_at(&self, block: u32, scale: usize) -> bool {
        usize::from(self.finest[block as usize]) <= scale
    }

    /// The voxels of block `block`, which [is resolved](Self::is_resolved_at) at `scale`; means where it is finer.
    #[inline(always)]
    pub fn voxels(&self, block: u32, scale: usize) -> &[Voxel] {
        &self.get(block, scale).voxels
    }

    /// Whether any of the eight voxels of the cell at `c` is observed; all eight lie in block `block`.
    #[inline(always)]
    pub fn is_cell_observed(&self, block: u32, scale: usize, c: [usize; 3]) -> bool {
        self.get(block, scale).observed_cells[c[2]] >> (c[0] + EDGE * c[1]) & 1 == 1
    }

    #[inline(always)]
    fn get(&self, block: u32, scale: usize) -> &CachedBlock {
        self.blocks[scale][block as usize].get_or_init(|| {
            let id = self.ids[block as usize];
            let voxels = resolve_block(self.field, id, scale).1.unwrap_or_else(|| self.field.current(self.field.block(id)).into());
            CachedBlock::new(voxels, scale)
        })
    }

    /// Intensity of voxel `index` of block `block` at `scale`, if it is known: the mean where the block is finer.
    pub fn intensity(&self, block: u32, scale: usize, index: usize) -> Option<u8> {
        let block = self.field.block(self.ids[block as usize]);
        if !self.field.has_intensity(block) {
            return None;
        }
        let intensity = intensity_at(voxel_coords(index, scale), scale, usize::from(block.scale), |i| self.field.intensity(block, i));
        (intensity > 0).then_some(intensity)
    }
}
