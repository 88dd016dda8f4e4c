//! How wrong a pose can have become: what a single registration does not see.
//!
//! A scan lies on surfaces that were first seen from elsewhere. It errs as the poses did from which they were seen, and by its own registration. In a room, all scans hang
//! on the first ones, and errors hardly add up; along a road, surfaces are renewed all the time, and they do. So errors grow with the path along which surfaces are renewed, by what registrations say of
//! themselves, by small errors to one side of the map, and with the distance by what the ranges of a sensor are wrong as a whole. The constants are those under which true errors of recorded and
//! simulated drives are within 1, 2 and 3 standard deviations as often as they should be, to a tenth, or more often (docs/experiments/elastic/drift.md).

use super::report::{OdometryReport, Status, registration_covariance};
use crate::graph::{adjoint, symmetric, upper_triangle};
use crate::registration::{LocalMap, Surfel};
use nalgebra::{Matrix6, Point3, Vector6};
use serde::{Deserialize, Serialize};
use voxelastic::geometry::{Pose, PoseExt};

/// One piece of this many is asked how old it is.
const ASKED: usize = 4;
/// Share of the path on which errors add up although the surfaces are known: nearer ones are seen better.
const KNOWN: f64 = 0.4;
/// Registrations err alike along a path of this length, metres.
const ALIKE: f64 = 5.0;
/// Standard deviations that a metre of renewed surfaces adds: metres and radians.
const PER_METRE: [f64; 2] = [0.01, 8e-4];
/// By what share of a distance the ranges of a sensor, or the times of its points, can be wrong as a whole.
const SCALE: f64 = 0.008;

/// How errors have grown since the first scan of a piece.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Drift {
    #[serde(with = "voxelastic::geometry::stored")]
    t_map_first: Pose,
    /// Covariance of the random part in the frame of the last scan: upper triangle.
    random: [f64; 21],
    /// Where on the path the surfaces were first seen on which the last scan lies, metres.
    anchor: f64,
}

impl Drift {
    /// None yet.
    pub(super) fn new(t_map_first: Pose) -> Self {
        Self { t_map_first, random: [0.0; 21], anchor: 0.0 }
    }

    /// Adds a scan `moved` from the last one, after a path whose surfaces are `age` metres old in the mean. Returns the covariance that it adds to what came before, and that
    /// since the first scan.
    pub(super) fn add(&mut self, moved: &Pose, t_map_lidar: &Pose, [path, age]: [f64; 2], information: &Matrix6<f64>) -> [Matrix6<f64>; 2] {
        let anchor = self.anchor.max(path - age);
        let renewed = KNOWN * moved.translation.vector.norm() + (1.0 - KNOWN) * (anchor - self.anchor);
        self.anchor = anchor;
        let [metres, radians] = PER_METRE.map(|sigma| sigma * sigma);
        let biased = Matrix6::from_diagonal(&Vector6::new(metres, metres, metres, radians, radians, radians));
        let registered = registration_covariance(information);
        let growth = (registered / ALIKE + biased) * renewed;
        let random = carried(&symmetric(&self.random), moved) + growth;
        self.random = upper_triangle(&random);
        [growth, random + registered + scale(self.t_map_first.translation_distance(t_map_lidar))]
    }
}

/// How far the lidar has moved since the surfaces of a level of the map on which these pieces of a scan lie were first seen, metres, in the mean.
pub(super) fn age(surfels: &[Surfel], t_voxels_lidar: &Pose, level: &LocalMap) -> f64 {
    let at = |surfel: &Surfel| (t_voxels_lidar * Point3::from(surfel.point.map(f64::from))).into();
    let ages = surfels.iter().step_by(ASKED).filter_map(|surfel| level.age_at(at(surfel)));
    let (sum, count) = ages.fold((0.0, 0.0), |(sum, count), age| (sum + age, count + 1.0));
    sum / f64::max(count, 1.0)
}

/// Covariance of how the lidar moved from the first of some reports in turn to the last: of the error of the last pose in the frame of that scan (x y z roll pitch yaw, square metres and radians),
/// if the first is right. Reports without a registered pose are passed over; `None` if they are of several pieces, or fewer than two are left.
pub fn covariance_between(reports: &[OdometryReport]) -> Option<Matrix6<f64>> {
    let placed: Vec<&OdometryReport> = reports.iter().filter(|report| !matches!(report.status, Status::Failed(_))).collect();
    let (first, last) = (*placed.first()?, *placed.last()?);
    if placed.len() < 2 || first.piece != last.piece {
        return None;
    }
    let own = |report: &OdometryReport| if report.status == Status::First { Matrix6::zeros() } else { registration_covariance(&report.information) };
    let grown = placed.windows(2).fold(own(first), |sum, pair| carried(&sum, &pair[0].t_map_lidar.inv_mul(&pair[1].t_map_lidar)) + pair[1].growth);
    Some(grown + own(last) + scale(first.t_map_lidar.translation_distance(&last.t_map_lidar)))
}

/// The covariance of an error in the frame of a scan as that of the error that it causes after a motion.
fn carried(covariance: &Matrix6<f64>, moved: &Pose) -> Matrix6<f64> {
    let back = adjoint(&moved.inverse());
    back * covariance * back.transpose()
}

fn scale(distance: f64) -> Matrix6<f64> {
    let variance = (SCALE * distance).powi(2);
    Matrix6::from_diagonal(&Vector6::new(variance, variance, variance, 0.0, 0.0, 0.0))
}
