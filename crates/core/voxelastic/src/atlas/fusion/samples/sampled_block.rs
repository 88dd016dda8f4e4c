//! A field at the voxels of a block of the target's lattice, decoded.

use crate::field::tsdf::propagate::{Interpolation, propagate_down};
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{ObservationCount, Voxel};
use crate::octree::{voxel_coords, voxel_index, voxels_at};

/// Words of a bit set of a block's voxels.
pub(crate) const WORDS: usize = voxels_at(0) / 64;

/// The samples of a field at the voxels of a block.
#[derive(Debug)]
pub(crate) struct SampledBlock {
    pub key: u64,
    pub scale: u8,
    /// Beams that observed the source there.
    pub observation_count: ObservationCount,
    pub voxels: Box<[Voxel]>,
    /// 0 where unknown.
    pub intensities: Option<Box<[u8]>>,
    /// Bit set of the observed voxels, 64 to a word.
    pub observed: [u64; WORDS],
}

/// A sampled block, encoded.
#[derive(Debug)]
pub(crate) struct EncodedBlock {
    pub key: u64,
    pub scale: u8,
    /// Beams that observed the source there.
    pub observation_count: ObservationCount,
    pub array: EncodedArray,
}

impl SampledBlock {
    /// A block of given voxels.
    #[cfg(test)]
    pub fn new(key: u64, scale: u8, observation_count: ObservationCount, voxels: Box<[Voxel]>, intensities: Option<Box<[u8]>>) -> Self {
        let observed = observed(&voxels);
        Self { key, scale, observation_count, voxels, intensities, observed }
    }

    /// The block in encoded form.
    pub fn encode(&self) -> EncodedBlock {
        let array = EncodedArray::new(self.scale.into(), &self.voxels, self.intensities.as_deref()).into_tight();
        EncodedBlock { key: self.key, scale: self.scale, observation_count: self.observation_count, array }
    }

    /// Interpolates the voxels at the finer scale `to`.
    pub fn refine(&mut self, to: usize) {
        let from = usize::from(self.scale);
        if from > to {
            self.voxels = refine(std::mem::take(&mut self.voxels).into_vec(), from, to).into();
            self.intensities = self.intensities.take().map(|intensities| resize_intensities(intensities.into_vec(), from, to).into());
            self.scale = to as u8;
            self.observed = observed(&self.voxels);
        }
    }
}

/// `voxels` of scale `from` at the finer scale `to`.
pub(crate) fn refine(mut voxels: Vec<Voxel>, from: usize, to: usize) -> Vec<Voxel> {
    for scale in (to..from).rev() {
        let mut fine = vec![Voxel::default(); voxels_at(scale)];
        propagate_down(&voxels, &mut fine, scale, &Interpolation::NEAR);
        voxels = fine;
    }
    voxels
}

/// Intensities of scale `from` at scale `to`, each from the voxel at the same position.
pub(crate) fn resize_intensities(intensities: Vec<u8>, from: usize, to: usize) -> Vec<u8> {
    if from == to {
        return intensities;
    }
    let coordinate = |v: usize| if from >= to { v >> (from - to) } else { v << (to - from) };
    (0..voxels_at(to)).map(|i| intensities[voxel_index(voxel_coords(i, to).map(coordinate), from)]).collect()
}

fn observed(voxels: &[Voxel]) -> [u64; WORDS] {
    let mut set = [0; WORDS];
    voxels.iter().enumerate().for_each(|(i, voxel)| set[i / 64] |= u64::from(voxel.is_observed()) << (i % 64));
    set
}

/// Calls `of` with the number of each set bit, ascending.
#[inline(always)]
pub(crate) fn for_each_bit(set: &[u64; WORDS], mut of: impl FnMut(usize)) {
    for (word, bits) in set.iter().enumerate() {
        let mut left = *bits;
        while left != 0 {
            of(64 * word + left.trailing_zeros() as usize);
            left &= left - 1;
        }
    }
}
