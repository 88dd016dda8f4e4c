//! Changing the scale of a block: what was observed at one scale is propagated to the next (paper Sec. III-A).

use super::block_run::ScaleChange;
use super::truncation::TruncationBand;
use crate::field::tsdf::propagate::{children, propagate_delta_down, propagate_down, propagate_up};
use crate::field::tsdf::{Array, BlockWriter, Voxel};
use crate::octree::voxels_at;

/// Fills the array of the new scale of block number `i` from the one of the scale that it leaves.
#[cold]
#[inline(never)]
pub(super) fn change_scale(writer: &mut BlockWriter<'_>, i: usize, change: ScaleChange, band: &TruncationBand) {
    let scale = usize::from(writer.block(i).scale);
    let [mut new, mut from, mut base] = [[Voxel::default(); voxels_at(0)]; 3];
    let new = &mut new[..voxels_at(scale)];
    let mut interpolated = 0;
    let interpolation = band.interpolation();
    let copy = |array: Array, into: &mut [Voxel; voxels_at(0)]| writer.copy(i, array, &mut into[..voxels_at(array.scale())]);
    match change {
        ScaleChange::None => return,
        ScaleChange::Coarser => {
            copy(Array::Data(scale - 1), &mut from);
            interpolated = propagate_up(&from[..voxels_at(scale - 1)], new, scale - 1);
        }
        ScaleChange::Finer => {
            copy(Array::Data(scale + 1), &mut from);
            copy(Array::Base(scale + 1), &mut base);
            writer.copy(i, Array::Data(scale), new);
            let coarse = ..voxels_at(scale + 1);
            propagate_delta_down(&from[coarse], &base[coarse], new, scale, band.max_weight as u16, &interpolation);
        }
        ScaleChange::FinerNew => {
            copy(Array::Data(scale + 1), &mut from);
            propagate_down(&from[..voxels_at(scale + 1)], new, scale, &interpolation);
        }
    }
    let mut intensities = [0; voxels_at(0)];
    let intensities = &mut intensities[..voxels_at(scale)];
    if writer.block(i).has_intensity {
        change_intensities(writer, i, change, intensities);
    }
    writer.store(i, Array::Data(scale), new, intensities);
    if change == ScaleChange::Coarser {
        // Interpolated voxels are no part of the base: what is measured there later is propagated to finer voxels as a whole.
        (0..new.len()).filter(|i| interpolated >> i & 1 == 1).for_each(|i| new[i] = Voxel::default());
        intensities.fill(0);
        writer.store(i, Array::Base(scale), new, intensities);
    }
}

/// Propagates intensities: copies to finer voxels, means of known ones to coarser voxels.
fn change_intensities(writer: &BlockWriter<'_>, i: usize, change: ScaleChange, intensities: &mut [u8]) {
    let scale = usize::from(writer.block(i).scale);
    let mut from = [0; voxels_at(0)];
    let copy = |scale: usize, into: &mut [u8]| writer.copy_intensities(i, scale, into);
    match change {
        ScaleChange::Coarser => {
            copy(scale - 1, &mut from[..voxels_at(scale - 1)]);
            for (i, intensity) in intensities.iter_mut().enumerate() {
                let known = || children(i, scale - 1).map(|c| u32::from(from[c])).filter(|&s| s > 0);
                *intensity = (known().sum::<u32>() / known().count().max(1) as u32) as u8;
            }
        }
        ScaleChange::FinerNew => {
            copy(scale + 1, &mut from[..voxels_at(scale + 1)]);
            for (i, &intensity) in from[..voxels_at(scale + 1)].iter().enumerate() {
                children(i, scale).for_each(|c| intensities[c] = intensity);
            }
        }
        ScaleChange::None | ScaleChange::Finer => copy(scale, intensities),
    }
}
