//! Each block's voxels as a mesh sees them: at one scale, with everything learnt at coarser scales carried down.

use crate::field::tsdf::colour::cube;
use crate::field::tsdf::propagate::{Guesses, propagate_delta_down, propagate_up};
use crate::field::tsdf::{Array, TsdfField, Voxel, VoxelBuffer};
use crate::octree::{SCALES, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;

/// The blocks of a field, each seen at the finest scale that it holds.
pub(crate) struct View<'a> {
    pub field: &'a TsdfField,
    /// Scale of each block.
    scales: Vec<u8>,
    /// Arrays of blocks whose current array is not what should be seen.
    settled: Vec<Option<Box<[Voxel]>>>,
}

impl<'a> View<'a> {
    pub fn new(field: &'a TsdfField) -> Self {
        let (scales, settled) = field.ids().into_par_iter().map(|id| settle(field, id, 0)).unzip();
        Self { field, scales, settled }
    }

    #[inline(always)]
    pub fn scale(&self, id: u32) -> usize {
        usize::from(self.scales[id as usize])
    }

    /// Copies the voxels of block `id` into the first ones of `voxels`.
    pub fn copy(&self, id: u32, voxels: &mut VoxelBuffer) {
        match &self.settled[id as usize] {
            Some(array) => voxels[..array.len()].copy_from_slice(array),
            None => {
                let block = self.field.block(id);
                self.field.copy(block, block.current(), &mut voxels[..voxels_at(self.scale(id))]);
            }
        }
    }

    /// Copies the intensities that the voxels of block `id` have, 0 where unknown, into the first of `shades`, unless it has none.
    pub fn copy_shades(&self, id: u32, shades: &mut [u8; voxels_at(0)]) -> bool {
        let block = self.field.block(id);
        if !self.field.is_shaded(block) {
            return false;
        }
        let (from, here) = (usize::from(block.scale), self.scale(id));
        let shades = &mut shades[..voxels_at(here)];
        if from == here {
            self.field.copy_shades(block, here, shades);
        } else {
            let held = self.field.shades(block, from);
            (0..shades.len()).for_each(|i| shades[i] = shade_at(voxel_coords(i, here), here, from, |i| held[i]));
        }
        true
    }
}

/// Intensity of voxel `c` at scale `here` of a block that has `shades` at scale `from`.
pub(crate) fn shade_at(c: [usize; 3], here: usize, from: usize, shades: impl Fn(usize) -> u8) -> u8 {
    if from >= here {
        return shades(voxel_index(c.map(|v| v >> (from - here)), from));
    }
    let known = cube(c, here, from).map(|i| u32::from(shades(i))).filter(|&s| s > 0);
    let (sum, count) = known.fold((0, 0), |(sum, count), s| (sum + s, count + 1));
    (sum / count.max(1)) as u8
}

/// The scale at which block `id` is seen, and its voxels there unless its current array is just that.
pub(crate) fn settle(field: &TsdfField, id: u32, least: usize) -> (u8, Option<Box<[Voxel]>>) {
    let block = field.block(id);
    let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
    let target = finest.max(least.min(SCALES - 1));
    if target == current {
        return (current as u8, None);
    }
    let mut voxels = field.current(block);
    for scale in (finest..current).rev() {
        let mut finer = field.voxels(block, Array::Data(scale));
        let past = field.voxels(block, Array::Past(scale + 1));
        propagate_delta_down(&voxels, &past, &mut finer, scale, u16::MAX, &Guesses::NEAR);
        voxels = finer;
    }
    for scale in current.min(finest)..target {
        let mut coarser = vec![Voxel::default(); voxels_at(scale + 1)];
        propagate_up(&voxels, &mut coarser, scale);
        voxels = coarser;
    }
    (target as u8, Some(voxels.into()))
}
