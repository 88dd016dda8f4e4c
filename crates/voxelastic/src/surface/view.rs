//! Each block's voxels as a mesh sees them: at one scale, with everything learnt at coarser scales carried down.

use crate::field::tsdf::propagate::{propagate_delta_down, propagate_up};
use crate::field::tsdf::{TsdfField, Voxel};
use crate::octree::{SCALES, voxels_at};
use rayon::prelude::*;

/// A field seen at the finest scale that each block holds, but not finer than a chosen one.
pub(crate) struct View<'a> {
    pub field: &'a TsdfField,
    /// Scale of each block, by id.
    scales: Vec<u8>,
    /// Arrays of blocks whose current array is not what should be seen.
    settled: Vec<Option<Box<[Voxel]>>>,
}

impl<'a> View<'a> {
    pub fn new(field: &'a TsdfField, coarsest_detail: usize) -> Self {
        let (scales, settled) = field.ids().into_par_iter().map(|id| settle(field, id, coarsest_detail)).unzip();
        Self { field, scales, settled }
    }

    #[inline(always)]
    pub fn scale(&self, id: u32) -> usize {
        usize::from(self.scales[id as usize])
    }

    #[inline(always)]
    pub fn voxels(&self, id: u32) -> &[Voxel] {
        match &self.settled[id as usize] {
            Some(voxels) => voxels,
            None => self.field.current(self.field.block(id)),
        }
    }

    /// Intensity at voxel `index` of block `id` as seen here, if the map has any.
    pub fn shade(&self, id: u32, index: usize) -> Option<u8> {
        let block = self.field.block(id);
        let from = usize::from(block.scale);
        let shades = self.field.shade(block)?;
        let c = crate::octree::voxel_coords(index, self.scale(id));
        let here = self.scale(id);
        let there = c.map(|v| if from >= here { v >> (from - here) } else { v << (here - from) });
        Some(shades[crate::octree::voxel_index(there, from)])
    }
}

/// The scale at which block `id` is seen, and its voxels there unless its current array is just that.
pub(crate) fn settle(field: &TsdfField, id: u32, least: usize) -> (u8, Option<Box<[Voxel]>>) {
    let block = field.block(id);
    let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
    let target = finest.max(least.min(SCALES - 1));
    if target == current {
        return (current as u8, None);
    }
    let mut voxels: Box<[Voxel]> = field.current(block).into();
    for scale in (finest..current).rev() {
        let mut finer: Box<[Voxel]> = field.voxels(block, scale).into();
        let past = field.past(block, scale + 1);
        propagate_delta_down(&voxels, past, &mut finer, scale, [u16::MAX; 2]);
        voxels = finer;
    }
    for scale in current.min(finest)..target {
        let mut coarser = vec![Voxel::default(); voxels_at(scale + 1)].into_boxed_slice();
        propagate_up(&voxels, &mut coarser, scale);
        voxels = coarser;
    }
    (target as u8, Some(voxels))
}
