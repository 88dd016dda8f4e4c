//! The update of one block: its free voxels and its rays.

use super::free_cells::{FreeCell, FreeExtent, OctantRef};
use crate::integrate::rays::select::BlockRays;
use crate::octree::SCALES;

/// A block and everything that the scan observes in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockTask {
    pub block: u32,
    pub octant: OctantRef,
    pub free: FreeVoxels,
    /// Its rays: records `start..end` of the selection.
    pub start: u32,
    pub end: u32,
}

/// The free voxels of a block.
#[derive(Clone, Copy, Debug)]
pub(super) enum FreeVoxels {
    None,
    All,
    /// Those of a mask in a thread's buffer.
    Mask {
        buffer: u32,
        mask: u32,
    },
}

impl BlockTask {
    #[inline(always)]
    pub fn new(block: u32, octant: OctantRef, free: FreeVoxels, rays: Option<&BlockRays>) -> Self {
        let (start, end) = rays.map_or((0, 0), |rays| (rays.start, rays.end));
        Self { block, octant, free, start, end }
    }
}

impl FreeCell {
    /// The coarsest scale at which a block can represent the cell, which is in `buffer`, and its free voxels; nothing for octants without a block.
    #[inline(always)]
    pub fn block_update(&self, buffer: u32) -> Option<(usize, FreeVoxels)> {
        match self.extent {
            FreeExtent::Octant { .. } => None,
            FreeExtent::Block => Some((SCALES - 1, FreeVoxels::All)),
            FreeExtent::Voxels { mask, scale } => Some((scale.into(), FreeVoxels::Mask { buffer, mask })),
        }
    }
}
