//! Each block's voxels at one scale, with updates at coarser scales propagated to it.

use crate::field::tsdf::resolve::{intensity_at, resolve_block};
use crate::field::tsdf::{TsdfField, Voxel, VoxelBuffer};
use crate::octree::{voxel_coords, voxels_at};
use rayon::prelude::*;

/// Blocks of a field, each resolved to the finest scale that it holds.
pub(crate) struct ResolvedBlocks<'a> {
    pub field: &'a TsdfField,
    /// Their ids, in Morton order.
    pub ids: Vec<u32>,
    /// Scale of each block of the field; undefined for others than these.
    scales: Vec<u8>,
    /// Resolved arrays of the blocks whose current array has another scale.
    arrays: Vec<Option<Box<[Voxel]>>>,
}

impl<'a> ResolvedBlocks<'a> {
    /// All blocks of a field.
    pub fn new(field: &'a TsdfField) -> Self {
        let (scales, arrays) = field.ids().into_par_iter().map(|id| resolve_block(field, id, 0)).unzip();
        Self { field, ids: field.ids_in_morton_order(), scales, arrays }
    }

    /// Some blocks of a field, in Morton order.
    pub fn of(field: &'a TsdfField, ids: Vec<u32>) -> Self {
        let count = field.ids().len();
        let (mut scales, mut arrays) = (vec![0; count], Vec::new());
        arrays.resize_with(count, || None);
        let resolved: Vec<_> = ids.par_iter().map(|id| resolve_block(field, *id, 0)).collect();
        for (&id, (scale, array)) in ids.iter().zip(resolved) {
            (scales[id as usize], arrays[id as usize]) = (scale, array);
        }
        Self { field, ids, scales, arrays }
    }

    #[inline(always)]
    pub fn scale(&self, id: u32) -> usize {
        usize::from(self.scales[id as usize])
    }

    /// Copies the voxels of block `id` into the first ones of `voxels`.
    pub fn copy(&self, id: u32, voxels: &mut VoxelBuffer) {
        match &self.arrays[id as usize] {
            Some(array) => voxels[..array.len()].copy_from_slice(array),
            None => {
                let block = self.field.block(id);
                self.field.copy(block, block.current(), &mut voxels[..voxels_at(self.scale(id))]);
            }
        }
    }

    /// Copies the intensities of the voxels of block `id`, 0 where unknown, into the first of `intensities`; returns false if it has none.
    pub fn copy_intensities(&self, id: u32, intensities: &mut [u8; voxels_at(0)]) -> bool {
        let block = self.field.block(id);
        if !self.field.has_intensity(block) {
            return false;
        }
        let (from, to) = (usize::from(block.scale), self.scale(id));
        let intensities = &mut intensities[..voxels_at(to)];
        if from == to {
            self.field.copy_intensities(block, to, intensities);
        } else {
            let stored = self.field.intensities(block, from);
            (0..intensities.len()).for_each(|i| intensities[i] = intensity_at(voxel_coords(i, to), to, from, |i| stored[i]));
        }
        true
    }
}
