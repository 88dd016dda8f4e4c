//! Blocks of the source, decoded at the scales at which they are sampled; all arrays of a scale lie in one vector, so that kernels can gather.

use crate::field::tsdf::resolve::{intensity_at, resolve_block};
use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::{BLOCK_EDGE, Cursor, SCALES, edge_at, voxel_coords, voxels_at};
use crate::simd::bits::lowest_bits;
use std::collections::HashMap;

/// A bit per voxel of a block: bit x of row y + 8 z, at every scale.
pub(crate) type Rows = [u8; BLOCK_EDGE * BLOCK_EDGE];

/// The arrays of one scale.
#[derive(Default)]
pub(crate) struct Arrays {
    /// Voxels, array after array: distance in the low half, weight in the high one. The first array is unobserved.
    pub voxels: Vec<u32>,
    /// Intensities at the same places, 0 where unknown; empty if no block has any.
    pub intensities: Vec<u8>,
    /// Observed voxels of each array.
    pub observed: Vec<Rows>,
    /// Number of the array of a block.
    number: HashMap<u32, u32>,
}

/// Some blocks of a field, decoded on first access.
pub(crate) struct DecodedBlocks<'a> {
    field: &'a TsdfField,
    arrays: [Arrays; SCALES],
}

impl<'a> DecodedBlocks<'a> {
    /// No blocks of `field` yet.
    pub fn new(field: &'a TsdfField) -> Self {
        Self { field, arrays: Default::default() }
    }

    /// The arrays at `scale`.
    pub fn at(&self, scale: usize) -> &Arrays {
        &self.arrays[scale]
    }

    /// Makes the unobserved array of `scale`, which every block that does not exist shares.
    pub fn prepare(&mut self, scale: usize) {
        if self.arrays[scale].observed.is_empty() {
            self.arrays[scale].push(scale, &vec![Voxel::default(); voxels_at(scale)]);
        }
    }

    /// The id of the block with Morton key `key`, if it exists.
    pub fn find(&self, cursor: &mut Cursor, key: u64) -> Option<u32> {
        cursor.block(self.field.tree(), key)
    }

    /// Whether block `id` holds voxels as fine as `scale`.
    pub fn is_resolved_at(&self, id: u32, scale: usize) -> bool {
        usize::from(self.field.block(id).finest) <= scale
    }

    /// Number of the array of block `id` at `scale`, at which it [is resolved](Self::is_resolved_at); means where it is finer.
    /// The scale is [prepared](Self::prepare).
    pub fn number(&mut self, id: u32, scale: usize) -> u32 {
        let arrays = &mut self.arrays[scale];
        if let Some(number) = arrays.number.get(&id) {
            return *number;
        }
        let number = arrays.observed.len() as u32;
        arrays.number.insert(id, number);
        let block = self.field.block(id);
        match resolve_block(self.field, id, scale).1 {
            Some(voxels) => arrays.push(scale, &voxels),
            None => {
                let mut voxels = [Voxel::default(); voxels_at(0)];
                self.field.copy(block, block.current(), &mut voxels[..voxels_at(scale)]);
                arrays.push(scale, &voxels[..voxels_at(scale)]);
            }
        }
        if self.field.has_intensity(block) {
            arrays.intensities.resize(arrays.voxels.len(), 0);
            let intensities = &mut arrays.intensities[number as usize * voxels_at(scale)..];
            let from = usize::from(block.scale);
            if from == scale {
                self.field.copy_intensities(block, scale, intensities);
            } else {
                let stored = self.field.intensities(block, from);
                (0..intensities.len()).for_each(|i| intensities[i] = intensity_at(voxel_coords(i, scale), scale, from, |i| stored[i]));
            }
        }
        number
    }
}

impl Arrays {
    fn push(&mut self, scale: usize, voxels: &[Voxel]) {
        let (n, mut observed) = (edge_at(scale), [0; BLOCK_EDGE * BLOCK_EDGE]);
        let mut flags = [0; voxels_at(0)];
        flags.iter_mut().zip(voxels).for_each(|(flag, voxel)| *flag = u8::from(voxel.is_observed()));
        for (i, row) in flags[..voxels.len()].chunks_exact(n).enumerate() {
            let mut eight = [0; BLOCK_EDGE];
            eight[..n].copy_from_slice(row);
            observed[i % n + BLOCK_EDGE * (i / n)] = lowest_bits(u64::from_le_bytes(eight)) as u8;
        }
        self.observed.push(observed);
        self.voxels.extend(voxels.iter().map(|voxel| u32::from(voxel.distance as u16) | u32::from(voxel.weight) << 16));
        if !self.intensities.is_empty() {
            self.intensities.resize(self.voxels.len(), 0);
        }
    }
}
