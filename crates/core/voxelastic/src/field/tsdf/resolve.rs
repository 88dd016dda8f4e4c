//! A block resolved to one scale: updates from coarser scales are propagated down, or its voxels up to a coarser scale.

use super::block::Array;
use super::colour::descendants;
use super::field::TsdfField;
use super::propagate::{Interpolation, propagate_delta_down, propagate_up};
use super::voxel::Voxel;
use crate::octree::{SCALES, voxel_index, voxels_at};

/// Intensity of voxel `c` at scale `here`, given the block's `intensities` at scale `from`: that of the coarser voxel around it, or the mean
/// of the known ones of the finer voxels in it. 0 means unknown.
pub(crate) fn intensity_at(c: [usize; 3], here: usize, from: usize, intensities: impl Fn(usize) -> u8) -> u8 {
    if from >= here {
        return intensities(voxel_index(c.map(|v| v >> (from - here)), from));
    }
    let known = descendants(c, here, from).map(|i| u32::from(intensities(i))).filter(|&s| s > 0);
    let (sum, count) = known.fold((0, 0), |(sum, count), s| (sum + s, count + 1));
    (sum / count.max(1)) as u8
}

/// Resolves block `id` to its finest scale, or to `least` if that is coarser. Returns the scale and the voxels there; no voxels if the
/// current array already has that scale.
pub(crate) fn resolve_block(field: &TsdfField, id: u32, least: usize) -> (u8, Option<Box<[Voxel]>>) {
    let block = field.block(id);
    let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
    let target = finest.max(least.min(SCALES - 1));
    if target == current {
        return (current as u8, None);
    }
    let mut voxels = field.current(block);
    for scale in (finest..current).rev() {
        let mut finer = field.voxels(block, Array::Data(scale));
        let base = field.voxels(block, Array::Base(scale + 1));
        propagate_delta_down(&voxels, &base, &mut finer, scale, u16::MAX, &Interpolation::NEAR);
        voxels = finer;
    }
    for scale in current.min(finest)..target {
        let mut coarser = vec![Voxel::default(); voxels_at(scale + 1)];
        propagate_up(&voxels, &mut coarser, scale);
        voxels = coarser;
    }
    (target as u8, Some(voxels.into()))
}
