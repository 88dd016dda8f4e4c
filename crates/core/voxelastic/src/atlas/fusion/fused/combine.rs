//! Several submaps' samples of one block become one: means by observations and nearness, and a decision where they contradict.

use crate::atlas::fusion::samples::sampled_block::{SampledBlock, WORDS, for_each_bit};
use crate::field::tsdf::{ObservationCount, Voxel, WEIGHT_ONE};
use crate::octree::voxels_at;

/// Samples on both sides of a surface that are farther apart than this, voxels, are of different surfaces: twice the usual reach of the band in front
/// of a surface or behind it is 3, and a mean of values at its ends would be a third surface between the two.
const CONTRADICTION: f32 = 2.0;
/// Of two surfaces that contradict, one is kept if it was observed this many times better; otherwise neither is, between them.
const CLEARLY: f32 = 2.0;
/// Down to this far behind a surface, voxels, a sample counts fully ...
const BEHIND_FULL: f32 = 0.5;
/// ... and from here on it counts [`LEAST_SHARE`]: what lies behind a surface was not seen, and may be in front of the next one.
const BEHIND_END: f32 = 1.5;
const LEAST_SHARE: f32 = 0.1;

/// How well submaps agree where they overlap. Counts are voxels; distances are in finest voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Voxels that one submap alone observed.
    pub alone: u64,
    /// Voxels of which the mean of several submaps was taken.
    pub merged: u64,
    /// Voxels at which submaps contradict by more than the truncation band: the better observed surface was kept, or none.
    pub refused: u64,
    /// Sums of the largest difference at each voxel, in thousandths of a finest voxel: integers, so that the order of summation does not matter.
    merged_milli: u64,
    refused_milli: u64,
}

impl Agreement {
    /// Mean difference between the submaps where they were merged, finest voxels.
    pub fn merged_apart(&self) -> f64 {
        self.merged_milli as f64 / 1e3 / self.merged.max(1) as f64
    }

    /// Mean difference between the submaps where they contradict, finest voxels.
    pub fn refused_apart(&self) -> f64 {
        self.refused_milli as f64 / 1e3 / self.refused.max(1) as f64
    }

    /// Adds the counts of `other`.
    pub(crate) fn add(&mut self, other: &Self) {
        self.alone += other.alone;
        self.merged += other.merged;
        self.refused += other.refused;
        self.merged_milli += other.merged_milli;
        self.refused_milli += other.refused_milli;
    }
}

/// The same for one block.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockAgreement {
    counts: [u16; 3],
    milli: [u32; 2],
}

impl Agreement {
    /// This of a single block, in less memory.
    pub(crate) fn of_block(&self) -> BlockAgreement {
        BlockAgreement {
            counts: [self.alone, self.merged, self.refused].map(|n| n as u16),
            milli: [self.merged_milli, self.refused_milli].map(|n| n as u32),
        }
    }
}

impl BlockAgreement {
    /// Adds the counts to `sum`.
    pub fn add_to(&self, sum: &mut Agreement) {
        let ([alone, merged, refused], [merged_milli, refused_milli]) = (self.counts.map(u64::from), self.milli.map(u64::from));
        sum.add(&Agreement { alone, merged, refused, merged_milli, refused_milli });
    }
}

/// A sample of one submap at a voxel of the block's scale.
#[derive(Clone, Copy)]
struct Vote {
    voxel: Voxel,
    /// Observations, by [`crate::field::tsdf::WEIGHT_ONE`]; those of a coarser voxel are divided among the finer ones in it.
    weight: f32,
}

/// Combines the samples of one block by several submaps, in a fixed order; adds to `agreement`. None if nothing is left.
pub(crate) fn combine(mut blocks: Vec<SampledBlock>, agreement: &mut Agreement) -> Option<SampledBlock> {
    let scale = usize::from(blocks.iter().map(|block| block.scale).min()?);
    if blocks.len() == 1 {
        agreement.alone += u64::from(blocks[0].observed.iter().map(|word| word.count_ones()).sum::<u32>());
        return blocks.pop();
    }
    let observation_count = blocks.iter().fold(ObservationCount::default(), |count, block| count.plus(block.observation_count.get()));
    // An observation of a coarser voxel is divided among the finer voxels in it.
    let shared: Vec<f32> = blocks.iter().map(|block| 1.0 / (1u32 << (3 * (usize::from(block.scale) - scale))) as f32).collect();
    blocks.iter_mut().for_each(|block| block.refine(scale));
    let (mut any, mut several) = ([0; WORDS], [0; WORDS]);
    for block in &blocks {
        for i in 0..WORDS {
            several[i] |= any[i] & block.observed[i];
            any[i] |= block.observed[i];
        }
    }
    let mut voxels = vec![Voxel::default(); voxels_at(scale)].into_boxed_slice();
    let mut observed: [u64; WORDS] = std::array::from_fn(|i| any[i] & !several[i]);
    agreement.alone += u64::from(observed.iter().map(|word| word.count_ones()).sum::<u32>());
    for block in &blocks {
        for_each_bit(&std::array::from_fn(|i| observed[i] & block.observed[i]), |i| voxels[i] = block.voxels[i]);
    }
    let (mut votes, edge) = (Vec::with_capacity(blocks.len()), (1u32 << scale) as f32);
    for_each_bit(&several, |i| {
        votes.clear();
        let known = blocks.iter().zip(&shared).filter(|(block, _)| block.voxels[i].is_observed());
        votes.extend(known.map(|(block, shared)| Vote { voxel: block.voxels[i], weight: f32::from(block.voxels[i].weight) * shared }));
        voxels[i] = combine_voxel(&votes, edge, agreement);
        observed[i / 64] |= u64::from(voxels[i].is_observed()) << (i % 64);
    });
    let intensities = mean_intensities(&blocks, observed);
    (observed != [0; WORDS]).then(|| SampledBlock { key: blocks[0].key, scale: scale as u8, observation_count, voxels, intensities, observed })
}

/// The voxel that votes, at least two, make; unobserved if they contradict and none is clearly better.
fn combine_voxel(votes: &[Vote], edge: f32, agreement: &mut Agreement) -> Voxel {
    let Some(first) = votes.first() else { return Voxel::default() };
    let distance = |vote: &Vote| vote.voxel.distance_in_voxels();
    let (low, high) = votes.iter().fold((distance(first), distance(first)), |(low, high), vote| (low.min(distance(vote)), high.max(distance(vote))));
    let apart = (1e3 * (high - low) * edge).round() as u64;
    if low >= 0.0 || high < 0.0 || high - low <= CONTRADICTION {
        agreement.merged += 1;
        agreement.merged_milli += apart;
        return mean(votes.iter());
    }
    agreement.refused += 1;
    agreement.refused_milli += apart;
    let weight = |in_front: bool| votes.iter().filter(|vote| (distance(vote) >= 0.0) == in_front).map(|vote| vote.weight).sum::<f32>();
    let (front, behind) = (weight(true), weight(false));
    if front.max(behind) < CLEARLY * front.min(behind) {
        return Voxel::default();
    }
    mean(votes.iter().filter(|vote| (distance(vote) >= 0.0) == (front > behind)))
}

/// The mean of the distances by observations and nearness; the observations add up.
fn mean<'a>(votes: impl Iterator<Item = &'a Vote>) -> Voxel {
    let (mut sum, mut shares, mut weight, mut most) = (0.0, 0.0, 0.0, 0);
    for vote in votes {
        let share = vote.weight * nearness(vote.voxel.distance_in_voxels());
        sum += share * f32::from(vote.voxel.distance);
        shares += share;
        weight += vote.weight;
        most = most.max(vote.voxel.weight);
    }
    let limits = (f32::from(i16::MIN), f32::from(i16::MAX));
    // However many submaps have a voxel from other scales only, it is not measured.
    let weight = if most < WEIGHT_ONE { weight.min(f32::from(WEIGHT_ONE - 1)) } else { weight };
    Voxel { distance: (sum / shares).round().clamp(limits.0, limits.1) as i16, weight: weight.round().clamp(1.0, f32::from(u16::MAX)) as u16 }
}

/// How much a sample at `distance` voxels from its surface counts.
fn nearness(distance: f32) -> f32 {
    ((distance + BEHIND_END) / (BEHIND_END - BEHIND_FULL)).clamp(LEAST_SHARE, 1.0)
}

/// Means of the known intensities of the `observed` voxels by their weights; none if no block has any.
fn mean_intensities(blocks: &[SampledBlock], observed: [u64; WORDS]) -> Option<Box<[u8]>> {
    let known: Vec<(&[u8], &[Voxel])> = blocks.iter().filter_map(|block| Some((block.intensities.as_deref()?, &block.voxels[..]))).collect();
    let mut means = vec![0; known.first()?.0.len()].into_boxed_slice();
    for_each_bit(&observed, |i| {
        let (mut sum, mut all) = (0, 0);
        for (intensities, voxels) in known.iter().filter(|(intensities, _)| intensities[i] > 0) {
            let weight = u32::from(voxels[i].weight);
            (sum, all) = (sum + u32::from(intensities[i]) * weight, all + weight);
        }
        means[i] = (sum / all.max(1)) as u8;
    });
    Some(means)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::DISTANCE_STEPS;
    use crate::octree::voxels_at;
    use proptest::prelude::*;

    fn steps(voxels: f32) -> i16 {
        (voxels * DISTANCE_STEPS).round() as i16
    }

    fn vote(distance: f32, observations: u16) -> Vote {
        let weight = observations * WEIGHT_ONE;
        Vote { voxel: Voxel { distance: steps(distance), weight }, weight: weight.into() }
    }

    fn found(votes: &[Vote]) -> (Voxel, Agreement) {
        let mut agreement = Agreement::default();
        (combine_voxel(votes, 1.0, &mut agreement), agreement)
    }

    #[test]
    fn near_surfaces_become_one() {
        // Two planes 0.75 voxels apart, observed equally: along their normal the mean changes sign once, between them.
        let signs: Vec<bool> = (-14..=14).map(|i| 0.1 * i as f32).map(|x| found(&[vote(x, 4), vote(x - 0.75, 4)]).0.distance >= 0).collect();
        assert_eq!(signs.windows(2).filter(|w| w[0] != w[1]).count(), 1, "{signs:?}");
        let crossing = -1.4 + 0.1 * signs.iter().position(|s| *s).unwrap_or_default() as f32;
        assert!((0.0..=0.75).contains(&crossing), "{crossing}");
    }

    #[test]
    fn of_surfaces_that_contradict_the_better_observed_one_is_kept() {
        let (voxel, agreement) = found(&[vote(1.4, 9), vote(-1.4, 2)]);
        assert_eq!((voxel.distance, voxel.weight, agreement.refused), (steps(1.4), 9 * WEIGHT_ONE, 1));
        assert!((agreement.refused_apart() - 2.8).abs() < 1e-2);
        let (voxel, agreement) = found(&[vote(1.4, 3), vote(-1.4, 2)]);
        assert_eq!((voxel, agreement.refused, agreement.merged), (Voxel::default(), 1, 0));
    }

    proptest! {
        #[test]
        fn a_block_equals_means_computed_voxel_by_voxel(
            samples in prop::collection::vec(prop::collection::vec((-1f32..1.0, 0u16..9), voxels_at(1)), 2..5),
        ) {
            let blocks = samples.iter().map(|voxels| {
                let voxels: Vec<Voxel> = voxels.iter().map(|(d, w)| Voxel { distance: if *w > 0 { steps(*d) } else { 0 }, weight: w * WEIGHT_ONE }).collect();
                SampledBlock::new(7, 1, ObservationCount::default(), voxels.into(), None)
            });
            let mut agreement = Agreement::default();
            let combined = combine(blocks.collect(), &mut agreement).map(|block| block.voxels.into_vec());
            let combined = combined.unwrap_or_else(|| vec![Voxel::default(); voxels_at(1)]);
            for i in 0..voxels_at(1) {
                let known: Vec<(f64, f64)> = samples.iter().filter(|s| s[i].1 > 0).map(|s| (f64::from(s[i].0), f64::from(s[i].1))).collect();
                prop_assert_eq!(combined[i].is_observed(), !known.is_empty());
                if known.is_empty() {
                    continue;
                }
                let near = |d: f64| if d >= -0.5 { 1.0 } else { d + 1.5 };
                let (sum, all) = known.iter().fold((0.0, 0.0), |(s, a), (d, w)| (s + d * w * near(*d), a + w * near(*d)));
                let expected = if known.len() == 1 { known[0].0 } else { sum / all };
                prop_assert!((f64::from(combined[i].distance_in_voxels()) - expected).abs() < 2e-3);
                prop_assert_eq!(f64::from(combined[i].weight), 16.0 * known.iter().map(|k| k.1).sum::<f64>());
            }
            prop_assert_eq!(agreement.refused, 0);
            prop_assert_eq!(agreement.alone + agreement.merged, combined.iter().filter(|v| v.is_observed()).count() as u64);
        }
    }
}
