//! Updating one block from everything that a scan said about it: at most one update per voxel and scan.
//!
//! A voxel that several beams met takes the largest evidence among them, and evidence of a beam outweighs the free space
//! found by the descent: so a pole that one beam hits is not erased by its neighbours that pass (FIELD, demand 17).

use super::descend::Mask;
use super::model::{Evidence, OccupancySettings, Steps};
use crate::field::occupancy::{LOG_ODDS_STEPS, Summary, UNKNOWN};
use crate::geometry::morton;
use crate::integrate::transform::Beam;
use crate::integrate::walk::{Line, local, walk_line};
use crate::octree::{voxel_coords, voxels_at};

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

/// Applies free space, then beams, to a block's `values` at `SCALE`; `corner` is its smallest corner in finest voxels.
#[inline(always)]
pub(super) fn update_block<'a, const SCALE: usize>(
    values: &mut [i8],
    free: FreeVoxels<'_>,
    corner: [f32; 3],
    beams: impl Iterator<Item = &'a Beam>,
    settings: &OccupancySettings,
    steps: &Steps,
) -> Outcome {
    let mut updates = [NO_UPDATE; voxels_at(0)];
    let updates = &mut updates[..voxels_at(SCALE)];
    match free {
        FreeVoxels::None => {}
        FreeVoxels::All => updates.fill(steps.free),
        FreeVoxels::Some(mask) => spread_mask::<SCALE>(mask, steps.free, updates),
    }
    for beam in beams {
        let evidence = Evidence::new(settings, beam.range * settings.voxel, SCALE);
        let (before, behind) = evidence.reach();
        let line = Line { point: local::<SCALE>(beam.point, corner), direction: beam.direction, gradient: beam.direction };
        walk_line::<SCALE>(&line, before, behind, |index, distance| {
            // The centre of a voxel may lie a little outside of the model's reach although the line is inside.
            let update = (evidence.at(distance.clamp(before, behind)) * LOG_ODDS_STEPS) as i8;
            updates[index] = updates[index].max(update);
        });
    }
    let (mut low, mut high) = (i8::MAX, i8::MIN);
    for (value, &update) in values.iter_mut().zip(updates.iter()) {
        let changed = steps.add(*value, update);
        *value = if update == NO_UPDATE { *value } else { changed };
        low = low.min(*value);
        high = high.max(*value);
    }
    Outcome { summary: Summary { value: UNKNOWN, max: high, observed: low != UNKNOWN }, uniform: (low == high).then_some(low) }
}

/// Writes `value` for every voxel at `SCALE` whose bit is set. The mask tells no finer voxels apart than `SCALE`.
#[inline(always)]
fn spread_mask<const SCALE: usize>(mask: &Mask, value: i8, updates: &mut [i8]) {
    let step = 1usize << (3 * SCALE);
    for (i, update) in updates.iter_mut().enumerate() {
        let c = voxel_coords(i, SCALE).map(|v| v as u32);
        let bit = morton::encode(c) as usize * step;
        if mask[bit >> 6] >> (bit & 63) & 1 == 1 {
            *update = value;
        }
    }
}
