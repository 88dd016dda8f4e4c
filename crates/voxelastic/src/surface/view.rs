//! Each block's voxels as a mesh sees them: at one scale, with everything learnt at coarser scales carried down.

use crate::field::tsdf::colour::cube;
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

    /// Intensity at voxel `index` of block `id` as seen here, if the map has any: where it is known finer, the mean of what was observed.
    pub fn shade(&self, id: u32, index: usize) -> Option<u8> {
        let block = self.field.block(id);
        let (from, here) = (usize::from(block.scale), self.scale(id));
        let shades = self.field.shade(block)?;
        let c = crate::octree::voxel_coords(index, here);
        if from >= here {
            return Some(shades[crate::octree::voxel_index(c.map(|v| v >> (from - here)), from)]);
        }
        let voxels = self.field.current(block);
        let observed = cube(c, here, from).filter(|&i| voxels[i].is_observed());
        let (sum, count) = observed.fold((0, 0), |(sum, count), i| (sum + u32::from(shades[i]), count + 1));
        Some((sum / count.max(1)) as u8)
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
