//! Updating one block from everything that a scan said about it: at most one update per voxel and scan.
//!
//! A voxel that several beams met takes the largest evidence among them, and evidence of a beam outweighs the free space
//! found by the descent: so a pole that one beam hits is not erased by its neighbours that pass (FIELD, demand 17).

use super::found::Mask;
use super::model::{Evidence, OccupancySettings, Steps};
use crate::field::occupancy::{LOG_ODDS_STEPS, Summary, UNKNOWN};
use crate::geometry::{morton, whole};
use crate::integrate::transform::Beam;
use crate::integrate::walk::{LANES, Line, Lines, MAX_STEPS, Trace};
use crate::octree::{voxel_coords, voxels_at};
use crate::sensor::{larger, smaller};

/// "No evidence" among updates: less than any evidence.
const NO_UPDATE: i8 = i8::MIN;

/// What the descent found of a block.
#[derive(Clone, Copy, Debug)]
pub(super) enum FreeVoxels<'a> {
    None,
    All,
    Some(&'a Mask),
}

/// A block's voxels after an update.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Outcome {
    pub summary: Summary,
    /// The value of all voxels, if they are equal.
    pub uniform: Option<i8>,
}

/// A block to update.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Its smallest corner, finest voxels of the submap.
    pub corner: [f32; 3],
    /// Its scale.
    pub scale: usize,
}

/// Beams that are walked together through the blocks that come next.
pub(super) struct Formation<'a> {
    settings: &'a OccupancySettings,
    lines: Lines,
    trace: Trace,
    /// Which block each line passes, by the caller's number.
    owner: [u32; LANES],
    /// The model, and its sigma for each line.
    evidence: Evidence,
    sigma: [f32; LANES],
    /// What each line says about the voxels that it passes.
    updates: [[i8; LANES]; MAX_STEPS],
}

impl<'a> Formation<'a> {
    pub fn new(settings: &'a OccupancySettings) -> Self {
        Self {
            settings,
            lines: Lines::new(),
            trace: Trace::new(),
            owner: [0; LANES],
            evidence: Evidence::new(settings, 0.0, 0),
            sigma: [0.0; LANES],
            updates: [[0; LANES]; MAX_STEPS],
        }
    }

    pub fn is_full(&self) -> bool {
        self.lines.len() == LANES
    }

    /// Adds the part of a beam that lies in a block.
    #[inline(always)]
    pub fn push(&mut self, owner: u32, place: Place, beam: &Beam) {
        let lane = self.lines.len() % LANES;
        let evidence = Evidence::new(self.settings, beam.range * self.settings.voxel, place.scale);
        let (before, behind) = evidence.reach();
        (self.owner[lane], self.sigma[lane]) = (owner, evidence.sigma());
        self.lines.push(&Line {
            point: beam.point,
            direction: beam.direction,
            gradient: beam.direction,
            corner: place.corner,
            scale: place.scale as u32,
            reach: [before, behind],
        });
    }

    /// Walks all lines and forgets them; returns how many there were. The voxels passed can be read until the next walk.
    #[inline(always)]
    pub fn walk(&mut self) -> usize {
        self.trace.walk(&self.lines);
        let model = self.evidence;
        for step in 0..self.trace.longest {
            for lane in 0..LANES {
                let evidence = model.with_sigma(self.sigma[lane]);
                let (before, behind) = evidence.reach();
                // The centre of a voxel may lie a little outside of the model's reach although the line is inside.
                let distance = smaller(larger(self.trace.quantity[step][lane], before), behind);
                let update = evidence.at(distance) * LOG_ODDS_STEPS;
                let size = whole(update.abs());
                self.updates[step][lane] = if update < 0.0 { -size } else { size } as i8;
            }
        }
        let lines = self.lines.len();
        self.lines.clear();
        lines
    }

    /// The block that line `lane` passes.
    #[inline(always)]
    pub fn owner(&self, lane: usize) -> u32 {
        self.owner[lane]
    }
}

/// What a scan says about the voxels of one block.
pub(super) struct Updates<'a> {
    steps: &'a Steps,
    updates: [i8; voxels_at(0)],
}

impl<'a> Updates<'a> {
    pub fn new(steps: &'a Steps) -> Self {
        Self { steps, updates: [NO_UPDATE; voxels_at(0)] }
    }

    /// Begins a block at `scale` with what the descent found.
    #[inline(always)]
    pub fn begin(&mut self, scale: usize, free: FreeVoxels<'_>) {
        match scale {
            0 => self.begin_at::<0>(free),
            1 => self.begin_at::<1>(free),
            2 => self.begin_at::<2>(free),
            _ => self.begin_at::<3>(free),
        }
    }

    #[inline(always)]
    fn begin_at<const SCALE: usize>(&mut self, free: FreeVoxels<'_>) {
        let updates = &mut self.updates[..voxels_at(SCALE)];
        match free {
            FreeVoxels::None => updates.fill(NO_UPDATE),
            FreeVoxels::All => updates.fill(self.steps.free),
            FreeVoxels::Some(mask) if SCALE == 0 => spread_finest(mask, self.steps.free, updates),
            FreeVoxels::Some(mask) => spread_mask::<SCALE>(mask, self.steps.free, updates),
        }
    }

    /// Notes the evidence of line `lane` where it is the largest so far.
    #[inline(always)]
    pub fn note(&mut self, formation: &Formation<'_>, lane: usize) {
        let (index, steps) = (&formation.trace.index, formation.trace.steps[lane] as usize);
        for (index, updates) in index.iter().zip(&formation.updates).take(steps) {
            let known = &mut self.updates[index[lane] as usize % voxels_at(0)];
            *known = (*known).max(updates[lane]);
        }
    }

    /// Folds the updates into the values of the block at `scale`.
    #[inline(always)]
    pub fn fold(&self, scale: usize, values: &mut [i8]) -> Outcome {
        match scale {
            0 => self.fold_at::<0>(values),
            1 => self.fold_at::<1>(values),
            2 => self.fold_at::<2>(values),
            _ => self.fold_at::<3>(values),
        }
    }

    #[inline(always)]
    fn fold_at<const SCALE: usize>(&self, values: &mut [i8]) -> Outcome {
        let steps = *self.steps;
        let (mut low, mut high) = (i8::MAX, i8::MIN);
        for (value, &update) in values[..voxels_at(SCALE)].iter_mut().zip(&self.updates[..voxels_at(SCALE)]) {
            let changed = steps.add(*value, update);
            *value = if update == NO_UPDATE { *value } else { changed };
            low = low.min(*value);
            high = high.max(*value);
        }
        Outcome { summary: Summary { value: UNKNOWN, max: high, observed: low != UNKNOWN }, uniform: (low == high).then_some(low) }
    }
}

/// Writes `value` for every voxel at `SCALE` whose bit is set, and [`NO_UPDATE`] for the others. The mask tells no finer voxels apart
/// than `SCALE`.
#[inline(always)]
fn spread_mask<const SCALE: usize>(mask: &Mask, value: i8, updates: &mut [i8]) {
    let step = 1usize << (3 * SCALE);
    for (i, update) in updates.iter_mut().enumerate() {
        let c = voxel_coords(i, SCALE).map(|v| v as u32);
        let bit = morton::encode(c) as usize * step;
        *update = if mask[bit >> 6] >> (bit & 63) & 1 == 1 { value } else { NO_UPDATE };
    }
}

/// As [`spread_mask`] for the finest voxels, a row of eight at a time: in each of two words of the mask, four of a row's bits lie two
/// and two beside each other.
#[inline(always)]
fn spread_finest(mask: &Mask, value: i8, updates: &mut [i8]) {
    const EVERY_BYTE: u64 = 0x0101_0101_0101_0101;
    const TWO_AND_TWO: u64 = 0x0303;
    let none = u64::from(NO_UPDATE as u8) * EVERY_BYTE;
    let change = u64::from((NO_UPDATE ^ value) as u8) * EVERY_BYTE;
    for (row, updates) in updates.as_chunks_mut::<8>().0.iter_mut().enumerate().take(64) {
        let (y, z) = (row & 7, row >> 3);
        let word = 2 * (y >> 2) + 4 * (z >> 2);
        let first = 2 * (y & 1) + 4 * (z & 1) + 16 * (y >> 1 & 1) + 32 * (z >> 1 & 1);
        let bits = (mask[word] >> first & TWO_AND_TWO) | (mask[word + 1] >> first & TWO_AND_TWO) << 16;
        // From two bits in every byte to two in every other one, to one in each.
        let bits = (bits | bits << 16) & 0x0000_ffff_0000_ffff;
        let bits = (bits | bits << 8) & 0x00ff_00ff_00ff_00ff;
        let bits = (bits | bits << 7) & EVERY_BYTE;
        *updates = (none ^ ((bits * 0xff) & change)).to_le_bytes().map(|byte| byte as i8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rows_of_a_mask_are_its_voxels(mask in prop::array::uniform8(any::<u64>()), value in -127i8..0) {
            let (mut fast, mut slow) = ([0i8; voxels_at(0)], [0i8; voxels_at(0)]);
            spread_finest(&mask, value, &mut fast);
            spread_mask::<0>(&mask, value, &mut slow);
            prop_assert_eq!(fast, slow);
        }
    }
}
