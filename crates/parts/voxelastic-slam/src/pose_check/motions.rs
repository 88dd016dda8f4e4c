//! How the sensor moved between two scans, by their surfaces.

use super::conventions::{CONVENTIONS, quarter_turns};
use crate::loops::{PlaceScan, levels, registration_settings, surfels, thinned};
use crate::registration::{Downsampler, LocalMap, Registration, Surfel, automatic_voxel_size, ranked, register, search};
use nalgebra::Translation3;
use voxelastic::Cloud;
use voxelastic::geometry::{Pose, PoseExt};

/// Points of a scan that are kept.
const MOST_POINTS: usize = 12_000;
/// Returns that are used, metres.
const RANGES: (f32, f32) = (0.5, 100.0);
/// Poses are wrong by about this where they are right, metres: how wide the registration looks.
const SIGMA: f64 = 0.5;
/// What the surfaces must say for a registration to count: overlap and score.
const LEAST: (f64, f64) = (0.35, 0.04);
/// The same where two starts lead to the same place, and how near that is, metres and radians.
const LEAST_TWICE: (f64, f64) = (0.2, 0.03);
const SAME_PLACE: (f64, f64) = (0.05, 0.01);
/// Another place than the given one counts if it fits better by this factor.
const BETTER: f64 = 1.1;
/// Of places that nobody gave, the best must fit better than the second by this factor.
const CLEARLY_BETTER: f64 = 1.25;
/// Poses that disagree by less than this agree: metres and radians for every pair, and shares of the motion on top, as odometry drifts.
const TOLERANCE: (f64, f64) = (0.15, 0.03);
const TOLERANCE_SHARE: f64 = 0.06;
/// Deviation of a registration, and of good poses: metres and radians for every pair, and a share of the motion.
const SIGMAS: (f64, f64) = (0.03, 0.004);
const SIGMA_SHARE: f64 = 0.02;
/// Starts of a search that are nearer to each other than this are one, metres and radians.
const SAME_START: (f64, f64) = (0.5, 0.2);
/// No sensor moves farther from one scan to the next, metres.
const FARTHEST: f64 = 40.0;

/// A scan, thinned, that is compared with another.
#[derive(Clone, Debug)]
pub struct CheckScan {
    index: usize,
    voxel: f64,
    scan: PlaceScan,
}

impl CheckScan {
    /// A scan, undistorted if the motion during its sweep is known; `index` is that of its pose.
    pub fn new(index: usize, cloud: &Cloud) -> Self {
        let undistorted = cloud.undistorted();
        let points = &undistorted.as_ref().unwrap_or(cloud).points;
        let is_used = |p: &&[f32; 3]| {
            let square: f32 = p.iter().map(|v| v * v).sum();
            square > RANGES.0 * RANGES.0 && square < RANGES.1 * RANGES.1
        };
        let used: Vec<[f32; 3]> = points.iter().filter(is_used).copied().collect();
        let voxel = automatic_voxel_size(&used);
        let points = thinned(&mut Downsampler::default(), &used, voxel, MOST_POINTS);
        Self { index, voxel, scan: PlaceScan { node: 0, t_anchor_lidar: Pose::identity(), points } }
    }

    /// Its returns, thinned, in the lidar's frame, metres.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.scan.points
    }

    /// Index of its pose.
    pub fn index(&self) -> usize {
        self.index
    }
}

/// The motion from one scan to another: pose of the lidar at the second in the frame of the first.
#[derive(Clone, Debug)]
pub(super) struct Motion {
    /// Indices of their poses.
    pub(super) rows: (usize, usize),
    /// By their poses.
    pub(super) given: Pose,
    /// By their surfaces.
    pub(super) measured: Pose,
}

/// How far apart two motions are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Discrepancy {
    pub(super) metres: f64,
    pub(super) radians: f64,
    /// Relative to what drift explains: 1 is as much.
    pub(super) relative: f64,
    /// In standard deviations of what is right.
    pub(super) sigmas: f64,
}

impl Discrepancy {
    pub(super) fn is_small(&self) -> bool {
        self.relative <= 1.0
    }
}

pub(super) fn discrepancy(given: &Pose, measured: &Pose) -> Discrepancy {
    let (metres, radians) = (given.translation_distance(measured), given.rotation_distance(measured));
    let (path, turn) = (measured.translation.vector.norm(), measured.rotation.angle());
    let over = |(m, rad): (f64, f64), share: f64| (metres / (m + share * path)).max(radians / (rad + share * turn));
    Discrepancy { metres, radians, relative: over(TOLERANCE, TOLERANCE_SHARE), sigmas: over(SIGMAS, SIGMA_SHARE) }
}

/// Registers a scan to another from their poses, and from no motion. None if the surfaces do not hold it.
pub(super) fn measure(first: &CheckScan, second: &CheckScan, track: &[(f64, Pose)]) -> Option<Motion> {
    let pair = Pair::new(first, second, track)?;
    let settings = registration_settings(first.voxel);
    let from = |start: &Pose| register(&pair.points, start, &pair.levels, SIGMA, &settings);
    let from_given = if pair.given.translation.vector.norm() < FARTHEST { from(&pair.given) } else { None };
    pair.measured(from_given, from(&Pose::identity()))
}

/// The same from everywhere that another reading of the poses could mean.
pub(super) fn measure_from_anywhere(first: &CheckScan, second: &CheckScan, track: &[(f64, Pose)]) -> Option<Motion> {
    let pair = Pair::new(first, second, track)?;
    let settings = registration_settings(first.voxel);
    let (a, b) = (&track.get(first.index)?.1, &track.get(second.index)?.1);
    let mut starts = vec![Pose::identity()];
    for change in CONVENTIONS {
        let motion = change.apply(a).inv_mul(&change.apply(b));
        for turn in quarter_turns() {
            let turned = Pose::from_parts(Translation3::from(turn.inverse() * motion.translation.vector), turn.inverse() * motion.rotation * turn);
            let is_new = |known: &Pose| known.translation_distance(&turned) > SAME_START.0 || known.rotation_distance(&turned) > SAME_START.1;
            if turned.translation.vector.norm() < FARTHEST && starts.iter().all(is_new) {
                starts.push(turned);
            }
        }
    }
    let found = ranked(search(&pair.points, &starts, &pair.levels, &settings));
    let is_clear = found.get(1).is_none_or(|second| found[0].score > CLEARLY_BETTER * second.score);
    let sharp =
        found.into_iter().next().filter(|_| is_clear).and_then(|found| register(&pair.points, &found.t_map_lidar, &pair.levels, SIGMA, &settings));
    pair.measured(None, sharp)
}

/// The middle one; 0 of none.
pub(crate) fn middle(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

struct Pair {
    rows: (usize, usize),
    given: Pose,
    points: Vec<Surfel>,
    levels: Vec<LocalMap>,
}

impl Pair {
    fn new(first: &CheckScan, second: &CheckScan, track: &[(f64, Pose)]) -> Option<Self> {
        let given = track.get(first.index)?.1.inv_mul(&track.get(second.index)?.1);
        let points = surfels(std::slice::from_ref(&second.scan), first.voxel);
        let levels = levels(std::slice::from_ref(&first.scan), first.voxel);
        Some(Self { rows: (first.index, second.index), given, points, levels })
    }

    /// The motion by the better of two registrations; the one from the given pose if both are about as good.
    fn measured(&self, from_given: Option<Registration>, other: Option<Registration>) -> Option<Motion> {
        let is_near = |a: &Pose, b: &Pose| a.translation_distance(b) < SAME_PLACE.0 && a.rotation_distance(b) < SAME_PLACE.1;
        let is_same = from_given.as_ref().zip(other.as_ref()).is_some_and(|(a, b)| is_near(&a.t_map_lidar, &b.t_map_lidar));
        let least = if is_same { LEAST_TWICE } else { LEAST };
        let holds = |r: &Registration| r.degenerate.is_empty() && r.overlap >= least.0 && r.score >= least.1;
        let found = match (from_given, other) {
            (Some(given), Some(other)) if other.score > BETTER * given.score => other,
            (Some(given), _) => given,
            (None, other) => other?,
        };
        holds(&found).then_some(Motion { rows: self.rows, given: self.given, measured: found.t_map_lidar })
    }
}
