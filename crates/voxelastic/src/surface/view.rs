//! Each block's voxels as a mesh sees them: at one scale, with everything learnt at coarser scales carried down.

use crate::field::tsdf::colour::cube;
use crate::field::tsdf::propagate::{propagate_delta_down, propagate_up};
use crate::field::tsdf::{Array, Block, TsdfField, Voxel, VoxelBuffer};
use crate::octree::{SCALES, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;

/// Blocks of a field seen at the finest scale that each holds, but not finer than a chosen one. Each is called by its place among the
/// blocks that are seen: in a view of a whole field, its id.
pub(crate) struct View<'a> {
    pub field: &'a TsdfField,
    /// Those that are seen.
    ids: Vec<u32>,
    /// Scale of each block.
    scales: Vec<u8>,
    /// Arrays of blocks whose current array is not what should be seen.
    settled: Vec<Option<Box<[Voxel]>>>,
}

impl<'a> View<'a> {
    pub fn new(field: &'a TsdfField) -> Self {
        Self::of(field, field.ids().collect(), 0)
    }

    /// A view of the blocks `ids` alone.
    pub fn of(field: &'a TsdfField, ids: Vec<u32>, coarsest_detail: usize) -> Self {
        let (scales, settled) = ids.par_iter().map(|&id| settle(field, id, coarsest_detail)).unzip();
        Self { field, ids, scales, settled }
    }

    #[inline(always)]
    fn block(&self, place: u32) -> &'a Block {
        self.field.block(self.ids[place as usize])
    }

    #[inline(always)]
    pub fn scale(&self, place: u32) -> usize {
        usize::from(self.scales[place as usize])
    }

    /// Copies the voxels of block `place` into the first ones of `voxels`.
    pub fn copy(&self, place: u32, voxels: &mut VoxelBuffer) {
        match &self.settled[place as usize] {
            Some(array) => voxels[..array.len()].copy_from_slice(array),
            None => {
                let block = self.block(place);
                self.field.copy(block, block.current(), &mut voxels[..voxels_at(self.scale(place))]);
            }
        }
    }

    /// Copies the intensities that the voxels of block `place` have, 0 where unknown, into the first of `shades`, unless it has none.
    pub fn copy_shades(&self, place: u32, shades: &mut [u8; voxels_at(0)]) -> bool {
        let block = self.block(place);
        if !self.field.is_shaded(block) {
            return false;
        }
        let (from, here) = (usize::from(block.scale), self.scale(place));
        let shades = &mut shades[..voxels_at(here)];
        if from == here {
            self.field.copy_shades(block, here, shades);
        } else {
            let held = self.field.shades(block, from);
            (0..shades.len()).for_each(|i| shades[i] = shade_at(voxel_coords(i, here), here, from, |i| held[i]));
        }
        true
    }

    /// Voxel `index` of block `place`.
    #[inline]
    pub fn voxel(&self, place: u32, index: usize) -> Voxel {
        match &self.settled[place as usize] {
            Some(voxels) => voxels[index],
            None => self.field.voxel(self.block(place), index),
        }
    }

    /// Intensity at voxel `index` of block `place` as seen here, if it is known: where it is known finer, the mean of that.
    pub fn shade(&self, place: u32, index: usize) -> Option<u8> {
        let block = self.block(place);
        let (from, here) = (usize::from(block.scale), self.scale(place));
        if !self.field.is_shaded(block) {
            return None;
        }
        let shade = shade_at(voxel_coords(index, here), here, from, |i| self.field.shade(block, i));
        (shade > 0).then_some(shade)
    }
}

/// Intensity of voxel `c` at scale `here` of a block that has `shades` at scale `from`.
fn shade_at(c: [usize; 3], here: usize, from: usize, shades: impl Fn(usize) -> u8) -> u8 {
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
        propagate_delta_down(&voxels, &past, &mut finer, scale, [u16::MAX; 2]);
        voxels = finer;
    }
    for scale in current.min(finest)..target {
        let mut coarser = vec![Voxel::default(); voxels_at(scale + 1)];
        propagate_up(&voxels, &mut coarser, scale);
        voxels = coarser;
    }
    (target as u8, Some(voxels.into()))
}
