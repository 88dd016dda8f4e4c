//! A page of a TSDF in versions 1 to 3 of the format, which are read and no longer written: as now ([`tsdf_page`](super::tsdf_page)), but in
//!
//! 3. a bit per voxel of all blocks' arrays, end to end, x fastest, least bit first: whether the voxel is anything but zero;
//! 5. weights in sixteenths of an observation, of a 64th in version 1;
//! 6. a bit per intensity of all blocks' arrays: whether it is anything but zero; then those that are.

use super::bytes::Bytes;
use super::frames::LARGEST;
use super::masks::{for_each_set, mask};
use super::tsdf_page::{cost, parse_heads};
use voxelastic::field::tsdf::{Voxel, WEIGHT_ONE};
use voxelastic::field::{BlockHead, TsdfBuilder};

/// The blocks of a page, unpacked.
#[derive(Debug)]
pub(super) struct Unpacked {
    heads: Vec<BlockHead>,
    voxels: Vec<Voxel>,
    intensities: Vec<u8>,
}

impl Unpacked {
    /// Makes weights of version 1 what they are now: upwards, so that what was observed stays so.
    pub fn update_weights(&mut self) {
        self.voxels.iter_mut().for_each(|voxel| voxel.weight = voxel.weight.div_ceil(64 / WEIGHT_ONE));
    }

    /// Adds the page's blocks to a field.
    pub fn build(&self, builder: &mut TsdfBuilder) -> Result<(), String> {
        let (mut voxels, mut intensities) = (&self.voxels[..], &self.intensities[..]);
        for head in &self.heads {
            let (array, later_voxels) = voxels.split_at(head.voxel_count());
            let (intensity, later_intensities) = intensities.split_at(head.intensity_count());
            builder.push(*head, array, intensity).map_err(|e| e.to_string())?;
            (voxels, intensities) = (later_voxels, later_intensities);
        }
        Ok(())
    }
}

/// Reads a page of `blocks` blocks; says in words what is wrong with it.
pub(super) fn parse(mut bytes: Bytes<'_>, blocks: usize) -> Result<Unpacked, String> {
    let heads = parse_heads(&mut bytes, blocks)?;
    if heads.iter().map(cost).sum::<usize>() > LARGEST {
        return Err("a page holds more blocks than any may".to_owned());
    }
    let voxels = voxels(&mut bytes, heads.iter().map(BlockHead::voxel_count).sum())?;
    let intensities = intensities(&mut bytes, heads.iter().map(BlockHead::intensity_count).sum())?;
    bytes.end()?;
    Ok(Unpacked { heads, voxels, intensities })
}

fn voxels(bytes: &mut Bytes<'_>, count: usize) -> Result<Vec<Voxel>, String> {
    let (mask, set) = mask(bytes, count)?;
    let mut plane = || bytes.take(set);
    let (distance_low, distance_high, weight_low, weight_high) = (plane()?, plane()?, plane()?, plane()?);
    let mut voxels = vec![Voxel::default(); count];
    let (mut at, mut distance) = (0, 0i16);
    for_each_set(mask, |i| {
        let folded = u16::from_le_bytes([distance_low[at], distance_high[at]]);
        distance = distance.wrapping_add((folded >> 1) as i16 ^ -((folded & 1) as i16));
        voxels[i] = Voxel { distance, weight: u16::from_le_bytes([weight_low[at], weight_high[at]]) };
        at += 1;
    });
    Ok(voxels)
}

fn intensities(bytes: &mut Bytes<'_>, count: usize) -> Result<Vec<u8>, String> {
    let (mask, set) = mask(bytes, count)?;
    let mut left = bytes.take(set)?.iter();
    let mut intensities = vec![0; count];
    for_each_set(mask, |i| intensities[i] = left.next().copied().unwrap_or_default());
    Ok(intensities)
}
