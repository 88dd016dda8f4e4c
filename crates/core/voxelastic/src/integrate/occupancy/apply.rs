//! Updating one block from everything that a scan observed in it: at most one update per voxel and scan.
//!
//! A voxel that several rays pass takes the largest evidence among them, and evidence of a ray outweighs the free space found by the descent. So a pole that one
//! ray hits is not erased by neighbouring rays that pass it.

use super::evidence::{Evidence, Steps};
use super::free_cells::Mask;
use super::settings::OccupancySettings;
use crate::field::occupancy::{FlipKind, LOG_ODDS_STEPS, Summary, UNKNOWN};
use crate::geometry::morton;
use crate::integrate::rays::dda::{LANES, MAX_STEPS, Segment, SegmentLanes, Traversal};
use crate::integrate::rays::ray::Ray;
use crate::octree::{voxel_coords, voxels_at};
use crate::simd::floor_positive;
use crate::simd::{larger, smaller};

/// "No evidence" among updates: less than any evidence.
const NO_UPDATE: i8 = i8::MIN;

/// The voxels of a block that the descent found free.
#[derive(Clone, Copy, Debug)]
pub(super) enum FreeMask<'a> {
    None,
    All,
    Some(&'a Mask),
}

/// The voxels of a block after an update.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct BlockOutcome {
    pub summary: Summary,
    /// The value of all voxels, if they are equal.
    pub uniform: Option<i8>,
    /// Which states of voxels changed.
    pub flips: FlipKind,
}

/// Position and scale of a block.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockFrame {
    /// Smallest corner, finest voxels of the submap.
    pub corner: [f32; 3],
    pub scale: usize,
}

/// Up to sixteen rays that are traversed together, in one block or several.
pub(super) struct RayBatch<'a> {
    settings: &'a OccupancySettings,
    segments: SegmentLanes,
    traversal: Traversal,
    /// Index of the task whose block each segment passes.
    owner: [u32; LANES],
    /// The evidence model, and its sigma for each segment.
    evidence: Evidence,
    sigma: [f32; LANES],
    /// Evidence of each segment for the voxels that it passes.
    evidence_steps: [[i8; LANES]; MAX_STEPS],
}

impl<'a> RayBatch<'a> {
    pub fn new(settings: &'a OccupancySettings) -> Self {
        Self {
            settings,
            segments: SegmentLanes::new(),
            traversal: Traversal::new(),
            owner: [0; LANES],
            evidence: Evidence::new(settings, 0.0, 0),
            sigma: [0.0; LANES],
            evidence_steps: [[0; LANES]; MAX_STEPS],
        }
    }

    pub fn is_full(&self) -> bool {
        self.segments.len() == LANES
    }

    /// Adds the part of a ray within the block of task `owner`.
    #[inline(always)]
    pub fn push(&mut self, owner: u32, frame: BlockFrame, ray: &Ray) {
        let lane = self.segments.len() % LANES;
        let evidence = Evidence::new(self.settings, ray.range * self.settings.voxel_size, frame.scale);
        let (front, back) = evidence.reach();
        (self.owner[lane], self.sigma[lane]) = (owner, evidence.sigma());
        self.segments.push(&Segment {
            point: ray.point,
            direction: ray.direction,
            gradient: ray.direction,
            corner: frame.corner,
            scale: frame.scale as u32,
            interval: [front, back],
        });
    }

    /// Traverses all segments and removes them; returns how many there were. Their voxels can be read until the next traversal.
    #[inline(always)]
    pub fn traverse(&mut self) -> usize {
        self.traversal.traverse(&self.segments);
        let model = self.evidence;
        for step in 0..self.traversal.longest {
            for lane in 0..LANES {
                let evidence = model.with_sigma(self.sigma[lane]);
                let (front, back) = evidence.reach();
                // The centre of a voxel may be a little outside of the model's reach although the segment is inside.
                let distance = smaller(larger(self.traversal.quantity[step][lane], front), back);
                let update = evidence.at(distance) * LOG_ODDS_STEPS;
                let size = floor_positive(update.abs());
                self.evidence_steps[step][lane] = if update < 0.0 { -size } else { size } as i8;
            }
        }
        let segments = self.segments.len();
        self.segments.clear();
        segments
    }

    /// Index of the task whose block the segment in `lane` passes.
    #[inline(always)]
    pub fn owner(&self, lane: usize) -> u32 {
        self.owner[lane]
    }
}

/// The evidence of a scan for the voxels of one block.
pub(super) struct VoxelEvidence<'a> {
    steps: &'a Steps,
    updates: [i8; voxels_at(0)],
}

impl<'a> VoxelEvidence<'a> {
    pub fn new(steps: &'a Steps) -> Self {
        Self { steps, updates: [NO_UPDATE; voxels_at(0)] }
    }

    /// Starts a block at `scale` with the voxels that the descent found free.
    #[inline(always)]
    pub fn begin(&mut self, scale: usize, free: FreeMask<'_>) {
        match scale {
            0 => self.begin_at::<0>(free),
            1 => self.begin_at::<1>(free),
            2 => self.begin_at::<2>(free),
            _ => self.begin_at::<3>(free),
        }
    }

    #[inline(always)]
    fn begin_at<const SCALE: usize>(&mut self, free: FreeMask<'_>) {
        let updates = &mut self.updates[..voxels_at(SCALE)];
        match free {
            FreeMask::None => updates.fill(NO_UPDATE),
            FreeMask::All => updates.fill(self.steps.free),
            FreeMask::Some(mask) if SCALE == 0 => spread_finest(mask, self.steps.free, updates),
            FreeMask::Some(mask) => spread_mask::<SCALE>(mask, self.steps.free, updates),
        }
    }

    /// Adds the evidence of the segment in `lane` where it is the largest so far.
    #[inline(always)]
    pub fn add(&mut self, batch: &RayBatch<'_>, lane: usize) {
        let (index, steps) = (&batch.traversal.index, batch.traversal.steps[lane] as usize);
        for (index, updates) in index.iter().zip(&batch.evidence_steps).take(steps) {
            let known = &mut self.updates[index[lane] as usize % voxels_at(0)];
            *known = (*known).max(updates[lane]);
        }
    }

    /// Adds the evidence to the values of the block at `scale`.
    #[inline(always)]
    pub fn apply(&self, scale: usize, values: &mut [i8]) -> BlockOutcome {
        match scale {
            0 => self.apply_at::<0>(values),
            1 => self.apply_at::<1>(values),
            2 => self.apply_at::<2>(values),
            _ => self.apply_at::<3>(values),
        }
    }

    #[inline(always)]
    fn apply_at<const SCALE: usize>(&self, values: &mut [i8]) -> BlockOutcome {
        let steps = *self.steps;
        let (mut low, mut high) = (i8::MAX, i8::MIN);
        let mut flips = FlipKind::default();
        for (value, &update) in values[..voxels_at(SCALE)].iter_mut().zip(&self.updates[..voxels_at(SCALE)]) {
            let changed = steps.add(*value, update);
            let changed = if update == NO_UPDATE { *value } else { changed };
            let flip = FlipKind::of(*value, changed);
            flips = FlipKind { occupied: flips.occupied | flip.occupied, free: flips.free | flip.free };
            *value = changed;
            low = low.min(*value);
            high = high.max(*value);
        }
        BlockOutcome { summary: Summary { value: UNKNOWN, max: high, observed: low != UNKNOWN }, uniform: (low == high).then_some(low), flips }
    }
}

/// Writes `value` for every voxel at `SCALE` whose bit is set, and [`NO_UPDATE`] for the others. The mask must be uniform within voxels of `SCALE`.
#[inline(always)]
fn spread_mask<const SCALE: usize>(mask: &Mask, value: i8, updates: &mut [i8]) {
    let step = 1usize << (3 * SCALE);
    for (i, update) in updates.iter_mut().enumerate() {
        let c = voxel_coords(i, SCALE).map(|v| v as u32);
        let bit = morton::encode(c) as usize * step;
        *update = if mask[bit >> 6] >> (bit & 63) & 1 == 1 { value } else { NO_UPDATE };
    }
}

/// As [`spread_mask`] for the finest voxels, a row of eight at a time. Four bits of a row are in one word of the mask and four in the next, in two pairs each.
#[inline(always)]
fn spread_finest(mask: &Mask, value: i8, updates: &mut [i8]) {
    const LOWEST_BITS: u64 = 0x0101_0101_0101_0101;
    const PAIRS: u64 = 0x0303;
    let none = u64::from(NO_UPDATE as u8) * LOWEST_BITS;
    let change = u64::from((NO_UPDATE ^ value) as u8) * LOWEST_BITS;
    for (row, updates) in updates.as_chunks_mut::<8>().0.iter_mut().enumerate().take(64) {
        let (y, z) = (row & 7, row >> 3);
        let word = 2 * (y >> 2) + 4 * (z >> 2);
        let first = 2 * (y & 1) + 4 * (z & 1) + 16 * (y >> 1 & 1) + 32 * (z >> 1 & 1);
        let bits = (mask[word] >> first & PAIRS) | (mask[word + 1] >> first & PAIRS) << 16;
        // From pairs of bits in every fourth byte to one bit in each byte.
        let bits = (bits | bits << 16) & 0x0000_ffff_0000_ffff;
        let bits = (bits | bits << 8) & 0x00ff_00ff_00ff_00ff;
        let bits = (bits | bits << 7) & LOWEST_BITS;
        *updates = (none ^ ((bits * 0xff) & change)).to_le_bytes().map(|byte| byte as i8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn spreading_rows_equals_spreading_voxels(mask in prop::array::uniform8(any::<u64>()), value in -127i8..0) {
            let (mut fast, mut slow) = ([0i8; voxels_at(0)], [0i8; voxels_at(0)]);
            spread_finest(&mask, value, &mut fast);
            spread_mask::<0>(&mask, value, &mut slow);
            prop_assert_eq!(fast, slow);
        }
    }
}
