//! Where a scan lies in the local map: first where it is expected, and if it does not fit there as usual, elsewhere.

use super::recent::RecentScans;
use super::report::Failure;
use crate::registration::{LocalMap, Registration, RegistrationSettings, Surfel, ranked, register, search};
use nalgebra::{Translation3, Unit, UnitQuaternion, Vector3};
use voxelastic::geometry::Pose;

/// Share of a scan's surfaces that must have a counterpart in the map.
const LEAST_OVERLAP: f64 = 0.3;
/// A registration whose score falls below this share of the usual one is doubted.
const USUAL_SCORE: f64 = 0.8;
/// A doubted pose is refused if more than this share of its surfaces contradicts the free space of the last scans, or theirs that of the scan.
const MOST_CONTRADICTION: f64 = 0.05;
/// Yaw angles from which a doubted scan is registered, too, degrees, to either side.
const STARTS: [f64; 9] = [10.0, 20.0, 35.0, 50.0, 70.0, 90.0, 115.0, 140.0, 165.0];

/// Cosines of the angles within which normals are alike, and beyond which they are others.
const ALIKE: f64 = 0.99;
const APART: f64 = 0.9;
/// Normals that must be alike to be common, and normals that are asked.
const LEAST_ALIKE: usize = 30;
const MOST_ASKED: usize = 200;

/// A prepared scan, and what it is registered to and judged by.
pub(super) struct Surroundings<'a> {
    pub(super) surfels: &'a [Surfel],
    /// Thinned returns, lidar frame.
    pub(super) points: &'a [[f32; 3]],
    /// From fine to coarse.
    pub(super) levels: &'a [LocalMap],
    /// Rotation of the levels in the map.
    pub(super) map_from_voxels: UnitQuaternion<f64>,
    pub(super) recent: &'a RecentScans,
    /// Mean score of the registrations before; 0 if there was none.
    pub(super) usual_score: f64,
    pub(super) settings: RegistrationSettings,
    /// Whether the sensor [leans](is_leaning).
    pub(super) is_leaning: bool,
}

/// Where a scan was found.
#[derive(Clone)]
pub(super) struct Found {
    pub(super) t_map_lidar: Pose,
    /// In the frame of the levels.
    pub(super) registration: Registration,
    /// Share of surfaces in space that was observed to be free; `None` if there was no reason to look, or too little to see.
    pub(super) contradiction: Option<f64>,
}

impl Surroundings<'_> {
    /// Registers the scan from a prediction that is wrong by about `sigma`, metres. If it fits worse than usual there, it is registered from other
    /// headings, too, at the prediction and at the last pose, and the best pose that does not contradict the free space counts.
    pub(super) fn find(&self, prediction: &Pose, last: &Pose, sigma: f64) -> Result<Found, Failure> {
        let expected = self.register_from(prediction, sigma);
        if let Some(found) = expected.as_ref().filter(|found| self.usual_score > 0.0 && self.is_usual(&found.registration)) {
            return Ok(found.clone());
        }
        let free_space = self.recent.compared(self.points, self.levels[0].size());
        let judged = |found: Found| Found { contradiction: free_space.as_ref().and_then(|both| both.contradiction(&found.t_map_lidar)), ..found };
        let is_possible = |found: &Found| found.contradiction.is_none_or(|share| share <= MOST_CONTRADICTION);
        // Without a usual score, a pose that is possible is good enough.
        let first = expected.as_ref().filter(|found| self.usual_score == 0.0 && found.registration.is_converged).cloned().map(judged);
        if let Some(found) = first.filter(is_possible) {
            return Ok(found);
        }
        let starts: Vec<Pose> = starts(prediction, last, &self.verticals()).iter().map(|start| self.map_from_voxels.inverse() * *start).collect();
        let others = search(self.surfels, &starts, self.levels, &self.settings).into_iter();
        let fitting = expected.map(|found| found.registration).into_iter().chain(others.filter(has_overlap));
        let candidates = ranked(fitting.collect());
        if candidates.is_empty() {
            return Err(Failure::TooLittleOverlap);
        }
        candidates.into_iter().map(|registration| judged(self.found(registration))).find(is_possible).ok_or(Failure::InFreeSpace)
    }

    /// Registers the scan from a pose in the map that is wrong by about `sigma`, metres; `None` if it overlaps too little.
    pub(super) fn register_from(&self, start: &Pose, sigma: f64) -> Option<Found> {
        let start = self.map_from_voxels.inverse() * start;
        register(self.surfels, &start, self.levels, sigma, &self.settings).filter(has_overlap).map(|registration| self.found(registration))
    }

    /// The axes about which headings turn, lidar frame: that of an upright sensor, and of one that is not what else may be the vertical.
    fn verticals(&self) -> Vec<Vector3<f64>> {
        let common = if self.is_leaning { common_normals(self.surfels) } else { Vec::new() };
        std::iter::once(Vector3::z()).chain(common.into_iter().filter(|axis| axis.z.abs() < APART)).collect()
    }

    fn found(&self, registration: Registration) -> Found {
        Found { t_map_lidar: self.map_from_voxels * registration.t_map_lidar, registration, contradiction: None }
    }

    fn is_usual(&self, found: &Registration) -> bool {
        found.is_converged && found.score > USUAL_SCORE * self.usual_score
    }
}

fn has_overlap(found: &Registration) -> bool {
    found.overlap >= LEAST_OVERLAP
}

/// Poses from which a doubted scan is registered: turned about each of these axes, lidar frame.
fn starts(prediction: &Pose, last: &Pose, axes: &[Vector3<f64>]) -> Vec<Pose> {
    let mut starts = vec![*prediction, *last];
    for axis in axes {
        let axis = Unit::new_normalize(*axis);
        let turned = |pose: &Pose, degrees: f64| {
            pose * Pose::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&axis, f64::to_radians(degrees)))
        };
        for degrees in STARTS.into_iter().flat_map(|d| [d, -d]) {
            starts.push(turned(last, degrees));
            if degrees.abs() < 30.0 {
                starts.push(turned(prediction, degrees));
            }
        }
    }
    starts
}

/// Whether most surfaces of a scan face another way than those of an upright sensor, which sees the ground: it is tilted by more than 25 degrees, or on its side.
pub(super) fn is_leaning(surfels: &[Surfel]) -> bool {
    common_normals(surfels).first().is_some_and(|axis| axis.z.abs() < APART)
}

/// Directions that most surfaces face, at most three: of floors and walls, one of them is the vertical.
fn common_normals(surfels: &[Surfel]) -> Vec<Vector3<f64>> {
    let mut normals: Vec<Vector3<f64>> = surfels.iter().map(|s| Vector3::from(s.normal.map(f64::from))).filter(|n| n.norm_squared() > 0.5).collect();
    let mut common = Vec::new();
    while common.len() < 3 && normals.len() >= LEAST_ALIKE {
        let step = normals.len().div_ceil(MOST_ASKED);
        let alike = |n: &Vector3<f64>| normals.iter().filter(|other| n.dot(other).abs() > ALIKE).count();
        let Some((count, best)) = normals.iter().step_by(step).map(|n| (alike(n), *n)).reduce(|a, b| if b.0 > a.0 { b } else { a }) else { break };
        if count < LEAST_ALIKE {
            break;
        }
        let sum: Vector3<f64> = normals.iter().filter(|n| n.dot(&best).abs() > ALIKE).map(|n| n * n.dot(&best).signum()).sum();
        let axis = sum.normalize();
        normals.retain(|n| n.dot(&axis).abs() < APART);
        common.push(axis);
    }
    common
}
