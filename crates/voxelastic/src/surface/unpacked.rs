//! Arrays at rest, unpacked for the blocks around: in Morton order the same ones are asked for again and again.

use super::view::View;
use crate::field::tsdf::{Voxel, VoxelBuffer};
use crate::octree::{NONE, voxels_at};

/// Arrays kept: those of a cube of eight blocks along each axis, so that blocks beside each other never share a place.
const KEPT: usize = 512;

/// The arrays unpacked last.
pub(super) struct Unpacked {
    /// The block in each place.
    ids: Vec<u32>,
    arrays: Vec<VoxelBuffer>,
}

impl Unpacked {
    pub fn new() -> Self {
        Self { ids: vec![NONE; KEPT], arrays: bytemuck::allocation::zeroed_vec(KEPT) }
    }

    /// Unpacks block `id` if it is at rest.
    #[inline]
    pub fn hold(&mut self, view: &View<'_>, id: u32) {
        let place = place(view, id);
        if self.ids[place] != id && view.in_place(id).is_none() {
            self.ids[place] = id;
            view.unpack(id, &mut self.arrays[place]);
        }
    }

    /// The voxels of block `id`, in place or unpacked: then it must be one of the neighbours held last.
    #[inline]
    pub fn voxels<'a>(&'a self, view: &'a View<'_>, id: u32) -> &'a [Voxel] {
        view.in_place(id).unwrap_or_else(|| &self.arrays[place(view, id)][..voxels_at(view.scale(id))])
    }
}

fn place(view: &View<'_>, id: u32) -> usize {
    view.field.block(id).key as usize % KEPT
}
