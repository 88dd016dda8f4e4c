//! How wrong the poses between two places can be, measured along the way.
//!
//! Poses come from odometries of all kinds, and most say nothing of their errors. But a place has scans enough to register its second half to its first: what that
//! moves is what the poses got wrong over this length. Such errors add up as random walks do. A share of the path comes on top, for errors that registration has
//! itself, as of a sensor's own bias. Turns about the vertical and tilts, and positions across it and along it, are told apart: a storey is not a drift.
//!
//! The two halves of a place also say how much of what is right lies in space that was seen to be free: by noise, by what moves, by poses that are a little off.

use super::align::settings;
use super::place::{Place, PlaceScan, free_voxel, levels, surfels};
use crate::free_space::contradiction;
use crate::registration::register;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use voxelastic::geometry::Pose;

/// What poses may be wrong by before anything was measured, for each root of a metre of path: turns in radians, and shifts in metres.
const PRIOR: (f64, f64) = (0.0026, 0.05);
/// Metres of path that this counts for.
const PRIOR_METRES: f64 = 5.0;
/// What errs alike along the whole path, as a share of it.
const ALIKE: f64 = 0.005;
/// Error that is always possible: in voxels, and radians.
const ALWAYS: (f64, f64) = (2.0, 0.05);
/// Standard deviations that a closure may claim.
const SIGMAS: f64 = 3.5;
/// Floors and roads that a place has as level are level to within this, radians.
const LEVEL_TO: f64 = 0.006;
/// Error to expect within a place, in voxels.
const WITHIN_PLACE: f64 = 0.5;
/// A half of a place that fits worse on the other, by overlap, measures nothing.
const LEAST_OVERLAP: f64 = 0.4;
/// Surfaces of another place may lie in free space with this share, and with so many times what is usual between the halves of a place.
const CONTRADICTION: (f64, f64) = (0.005, 4.0);
/// So many places say what is usual.
const LEAST_PLACES: f64 = 3.0;

/// Errors of poses over some metres of path: their sums, and those of their squares. Axes are those of the places, levelled.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Errors {
    metres: f64,
    turn: [[f64; 2]; 3],
    shift: [[f64; 2]; 3],
    /// Shares of the surfaces of one half of a place in space that the other saw to be free, and number of places.
    contradiction: [f64; 2],
}

impl Errors {
    /// What the poses got wrong from the first half of a place to its second; none where the surfaces cannot tell.
    pub(super) fn within(place: &Place, voxel: f64) -> Option<Self> {
        let (first, second) = place.scans.split_at(place.scans.len() / 2);
        let centre =
            |scans: &[PlaceScan]| scans.iter().map(|scan| scan.t_anchor_lidar.translation.vector).sum::<Vector3<f64>>() / scans.len().max(1) as f64;
        let (from, to) = (centre(first), centre(second));
        let metres = (to - from).norm();
        if first.is_empty() || metres < voxel {
            return None;
        }
        let moved = register(&surfels(second, voxel), &Pose::identity(), &levels(first, voxel), WITHIN_PLACE * voxel, &settings(voxel))?;
        if !moved.degenerate.is_empty() || moved.overlap < LEAST_OVERLAP {
            return None;
        }
        let t = &moved.t_map_lidar;
        let (turn, shift) = (place.level * t.rotation.scaled_axis(), place.level * (t.transform_vector(&to) + t.translation.vector - to));
        let views = place.views();
        let (of_first, of_second) = views.split_at(first.len());
        let contradiction = contradiction(of_first, of_second, t, free_voxel(voxel)).map_or([0.0; 2], |share| [share, 1.0]);
        let sums = |error: Vector3<f64>| std::array::from_fn(|k| [error[k], error[k] * error[k]]);
        Some(Self { metres, turn: sums(turn), shift: sums(shift), contradiction })
    }
}

/// How poses err along their path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drift(Errors);

impl Default for Drift {
    fn default() -> Self {
        let prior = |sigma: f64| [[0.0, PRIOR_METRES * sigma * sigma]; 3];
        Self(Errors { metres: PRIOR_METRES, turn: prior(PRIOR.0), shift: prior(PRIOR.1), contradiction: [0.0; 2] })
    }
}

impl Drift {
    pub(super) fn add(&mut self, measured: &Errors) {
        let sum = &mut self.0;
        sum.metres += measured.metres;
        let both = sum.turn.iter_mut().chain(&mut sum.shift).zip(measured.turn.iter().chain(&measured.shift));
        let contradiction = (&mut sum.contradiction, &measured.contradiction);
        both.chain([contradiction]).for_each(|(sum, more)| *sum = [sum[0] + more[0], sum[1] + more[1]]);
    }

    /// The largest share of surfaces in free space with which a place may be another one: what is usual within places says it, if that is less than `limit`.
    pub(super) fn most_contradiction(&self, limit: f64) -> f64 {
        let [sum, places] = self.0.contradiction;
        if places < LEAST_PLACES { limit } else { limit.min(CONTRADICTION.0 + CONTRADICTION.1 * sum / places) }
    }

    /// How far a claim about the pose of one place in the frame of another is from what the poses along `metres` of path say: the largest of its directions, in parts of
    /// what is possible. Beyond 1 it is not.
    pub(super) fn claimed(&self, (first, second): (&Place, &Place), expected: &Pose, claim: &Pose, metres: f64, voxel: f64) -> f64 {
        let shift = first.level * (claim.translation.vector - expected.translation.vector);
        let turn = first.level * (claim.rotation * expected.rotation.inverse()).scaled_axis();
        let Errors { metres: measured, turn: turns, shift: shifts, .. } = self.0;
        // Of some axes: variance by a random walk, and by what errs to one side.
        let variances = |sums: &[[f64; 2]]| {
            let squares = sums.iter().map(|s| s[1]).sum::<f64>() / sums.len() as f64;
            let bias = sums.iter().map(|s| s[0] * s[0]).sum::<f64>().sqrt();
            (squares / measured * metres, (bias / measured * metres).powi(2))
        };
        let (yaw, tilt, level, height) = (variances(&turns[2..]), variances(&turns[..2]), variances(&shifts[..2]), variances(&shifts[2..]));
        let position = |shifts: (f64, f64), by_turns: f64| {
            let variance = shifts.0 + shifts.1 + (by_turns + ALIKE * ALIKE) * metres * metres;
            SIGMAS * variance.sqrt() + ALWAYS.0 * voxel
        };
        let by_turns = |turns: (f64, f64)| turns.0 / 3.0 + turns.1 / 4.0;
        // Poses that are as level as the ground at both ends have not been tilted much in between.
        let by_tilts = off_level(first, second, expected).map_or(f64::INFINITY, |angle| angle.max(LEVEL_TO).powi(2) / 3.0).min(by_turns(tilt));
        let angle = |turns: (f64, f64)| SIGMAS * (turns.0 + turns.1).sqrt() + ALWAYS.1;
        let parts = [
            shift.xy().norm() / position(level, by_turns(yaw)),
            shift.z.abs() / position(height, by_tilts),
            turn.z.abs() / angle(yaw),
            turn.xy().norm() / angle(tilt),
        ];
        parts.into_iter().fold(0.0, f64::max)
    }
}

/// The angle between what two places have as the vertical, if the second is `expected` in the frame of the first; none if one of them has nothing level.
fn off_level(first: &Place, second: &Place, expected: &Pose) -> Option<f64> {
    let up = |place: &Place| (place.level != UnitQuaternion::identity()).then(|| place.level.inverse() * Vector3::z());
    Some(up(first)?.angle(&(expected.rotation * up(second)?)))
}
