//! The floor and the 2-D maps of it, compared with a world that is known exactly.

use crate::{Body, Ground, Known, Storey};
use rayon::prelude::*;
use serde::Serialize;
use voxelastic::field::occupancy::State;

/// A world that is known exactly, in the frame of the map, metres.
#[derive(Clone, Copy)]
pub struct TrueWorld<'a> {
    /// Signed distance to the nearest surface, negative inside.
    pub distance: &'a (dyn Fn([f64; 3]) -> f64 + Sync),
    /// How far it is from a point in a direction of length 1 to a surface, if that is within a length.
    pub cast: &'a (dyn Fn([f64; 3], [f64; 3], f64) -> Option<f64> + Sync),
}

/// Points along an edge of a cell where the world is looked at, if an obstacle may be in the cell.
const POINTS: usize = 5;
/// The true floor is looked for this far above and below that of the map, metres.
const REACH: f64 = 0.3;
/// A step is a difference of heights within this distance, metres, and two voxels more.
const STRIDE: f64 = 0.125;
/// Points along a vertical are no farther apart than this, metres.
const CLOSE: f64 = 0.01;

/// Cells of 2-D maps for the usual robot, compared with the world, and errors of the floor's height.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct FloorScores {
    /// Storeys.
    pub storeys: usize,
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Cells that are free in the map ...
    pub free: usize,
    /// ... of which part is in an obstacle between the robot's step and its height, ...
    pub free_but_blocked: usize,
    /// ... or the middle is more than a voxel inside of one, ...
    pub free_but_deep: usize,
    /// ... or there is no floor at that height.
    pub free_but_no_floor: usize,
    /// Cells that are occupied in the map ...
    pub occupied: usize,
    /// ... and touched by no obstacle, nor by a step of the floor, ...
    pub occupied_but_clear: usize,
    /// ... not even within a voxel.
    pub occupied_but_far: usize,
    /// Median of the absolute errors of the floor's height, metres.
    pub height_median_m: f64,
    /// 95th percentile.
    pub height_p95_m: f64,
    /// Share of the errors within two of the standard deviations that the map gives.
    pub within_two_sigma: f64,
}

/// What there is in the world where the map has a cell.
struct Judge<'a> {
    world: TrueWorld<'a>,
    body: Body,
    voxel: f64,
    edge: f64,
}

/// What is found in a cell: what the map says, what is wrong with that, and the error of the height with its standard deviation.
struct Found {
    state: State,
    wrong: [bool; 3],
    error: Option<[f64; 2]>,
}

/// Compares the floor of a map that was found for `body`, in cells of a voxel of `voxel` metres, with the world.
pub fn compare(world: TrueWorld<'_>, ground: &Ground, body: Body, voxel: f64) -> FloorScores {
    let judge = Judge { world, body, voxel, edge: voxel };
    let mut scores = FloorScores { storeys: ground.storeys().len(), resolution_m: voxel, ..FloorScores::default() };
    let mut errors: Vec<[f64; 2]> = Vec::new();
    for storey in ground.storeys() {
        let grid = ground.grid(storey);
        let found: Vec<Found> = (0..grid.states.len()).into_par_iter().filter_map(|cell| judge.cell(storey, cell, grid.states[cell])).collect();
        for Found { state, wrong, error } in found {
            let [first, second, third] = wrong.map(usize::from);
            if state == State::Free {
                scores.free += 1;
                (scores.free_but_blocked, scores.free_but_deep) = (scores.free_but_blocked + first, scores.free_but_deep + second);
                scores.free_but_no_floor += third;
            } else {
                scores.occupied += 1;
                (scores.occupied_but_clear, scores.occupied_but_far) = (scores.occupied_but_clear + first, scores.occupied_but_far + second);
            }
            errors.extend(error);
        }
    }
    errors.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
    let at = |share: f64| errors.get((share * errors.len() as f64) as usize).map_or(f64::NAN, |e| e[0]);
    (scores.height_median_m, scores.height_p95_m) = (at(0.5), at(0.95));
    scores.within_two_sigma = errors.iter().filter(|[error, sigma]| *error <= 2.0 * sigma).count() as f64 / errors.len().max(1) as f64;
    scores
}

impl Judge<'_> {
    fn cell(&self, storey: &Storey, cell: usize, state: State) -> Option<Found> {
        if state == State::Unknown {
            return None;
        }
        let (at, floor) = (storey.cells.centre(cell), &storey.floor[cell]);
        let height = f64::from(floor.height);
        let half = 0.5 * self.edge * 2f64.sqrt();
        let nearest = self.least_distance(at, height, half + 2.0 * self.voxel);
        let truth = self.floor(at, height);
        let error = truth.filter(|_| floor.known == Known::Seen && nearest > half).map(|truth| [(truth - height).abs(), f64::from(floor.sigma)]);
        let wrong = if state == State::Free {
            [nearest <= half && self.is_blocked(at, height), nearest < -self.voxel, truth.is_none() && nearest > half]
        } else {
            let is_clear = nearest > 0.0 && (nearest > half || !self.is_blocked(at, height)) && !self.has_step(at, height);
            [is_clear, is_clear && nearest > half + self.voxel, false]
        };
        Some(Found { state, wrong, error })
    }

    /// Height of the surface below a point just above the floor of the map.
    fn floor(&self, [x, y]: [f64; 2], height: f64) -> Option<f64> {
        let from = [x, y, height + REACH];
        let range = (self.world.cast)(from, [0.0, 0.0, -1.0], 2.0 * REACH)?;
        ((self.world.distance)(from) > 0.0).then_some(height + REACH - range)
    }

    /// Whether the true floor rises or falls by more than the robot climbs, or nearly so, or ends.
    fn has_step(&self, [x, y]: [f64; 2], height: f64) -> bool {
        let reach = STRIDE + 2.0 * self.voxel;
        let Some(here) = self.floor([x, y], height) else { return true };
        let around = (-2..=2).flat_map(|i| (-2..=2).map(move |j| [x + f64::from(i) * 0.5 * reach, y + f64::from(j) * 0.5 * reach]));
        around.into_iter().any(|p| self.floor(p, height).is_none_or(|there| (there - here).abs() > 0.7 * self.body.step))
    }

    /// Whether an obstacle is in the cell around a point.
    fn is_blocked(&self, at: [f64; 2], height: f64) -> bool {
        let offset = |k: usize| ((k as f64 + 0.5) / POINTS as f64 - 0.5) * self.edge;
        let points = (0..POINTS * POINTS).map(|k| [at[0] + offset(k % POINTS), at[1] + offset(k / POINTS)]);
        points.into_iter().any(|p| self.least_distance(p, height, 0.0) <= 0.0)
    }

    /// The least distance to an obstacle along the robot's height, exact where it is less than `enough`. The floor below is none.
    fn least_distance(&self, [x, y]: [f64; 2], height: f64, enough: f64) -> f64 {
        let (mut z, high, mut least) = (height + self.body.step, height + self.body.height, f64::INFINITY);
        let floor = self.floor([x, y], height).unwrap_or(height);
        while z <= high {
            let distance = (self.world.distance)([x, y, z]);
            if distance < z - floor - 1e-6 || floor > height + self.body.step {
                least = least.min(distance);
            }
            z += (distance - enough).max(CLOSE);
        }
        least
    }
}
