//! What the odometry says about a scan.

use super::level::Level;
use super::vertical::MeasuredVertical;
use crate::graph::{default_information, upper_triangle};
use nalgebra::{Matrix6, SymmetricEigen, Vector6};
use std::fmt::{self, Display};
use std::time::Duration;
use voxelastic::geometry::Pose;
use voxelastic::motion::Motion;

/// Less information than this in a direction is none, inverse square metres and radians.
const LEAST_INFORMATION: f64 = 1e-2;

/// The outcome for one scan.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct OdometryReport {
    /// Pose of the lidar in the map frame at the scan's time stamp. The map frame is the lidar frame of the first scan, levelled
    /// as `level` says.
    pub t_map_lidar: Pose,
    /// How the lidar moved during the sweep, if the points have times and a velocity is known: for [`Cloud::motion`](voxelastic::Cloud::motion).
    pub motion: Option<Motion>,
    /// Information of the pose in the lidar frame (x y z roll pitch yaw), inverse square metres and radians; zero if it was not registered.
    /// It follows from how the distances of pieces of surface scatter, and says how well the scan lies on the local map, not how far that has drifted.
    pub information: Matrix6<f64>,
    /// What this scan adds to the errors of those before, as a covariance in the lidar frame (x y z roll pitch yaw), square metres and radians; zero if it was not registered.
    /// [`covariance_between`](super::covariance_between) sums it up.
    pub growth: Matrix6<f64>,
    /// Covariance of the pose in the frame of the first scan of the piece: of the error in the lidar frame, as `growth`. Zero if it was not registered.
    pub covariance: Matrix6<f64>,
    /// Whether the pose can be used.
    pub status: Status,
    /// Number of the piece of the trajectory. No odometry edge leads from one piece to another.
    pub piece: usize,
    /// Whether the scan is far enough from the last keyframe to be one.
    pub is_keyframe: bool,
    /// Share of the scan's surfaces that have a counterpart in the map.
    pub overlap: f64,
    /// How well the scan fits: the mean weight of its surfaces, 1 where all lie on the map's.
    pub score: f64,
    /// Share of the surfaces of this scan or of the last ones in space that the other saw to be free; `None` where the scan fits as usual, so that
    /// there was no reason to look.
    pub contradiction: Option<f64>,
    /// Seconds since the last registered scan, if that is a gap in the data: more than a second, and several times what it was before.
    pub gap: Option<f64>,
    /// How the map frame was levelled.
    pub level: Level,
    /// Where up is, by the inertial unit: once in some seconds.
    pub vertical: Option<MeasuredVertical>,
    /// Whether every second scan comes from another place, for several scans in turn: those of two sensors in one stream.
    pub alternates: bool,
    /// Robust mean distance to the map's surfaces, metres.
    pub spread: f64,
    /// Iterations on all levels.
    pub iterations: usize,
    /// Wall time by phase.
    pub times: PhaseTimes,
}

impl OdometryReport {
    /// About a scan that was not registered: its pose is a prediction.
    pub(super) fn failed(failure: Failure, t_map_lidar: Pose, piece: usize, level: Level, times: PhaseTimes) -> Self {
        Self {
            t_map_lidar,
            motion: None,
            information: Matrix6::zeros(),
            growth: Matrix6::zeros(),
            covariance: Matrix6::zeros(),
            status: Status::Failed(failure),
            piece,
            is_keyframe: false,
            overlap: 0.0,
            score: 0.0,
            contradiction: None,
            level,
            vertical: None,
            alternates: false,
            gap: None,
            spread: 0.0,
            iterations: 0,
            times,
        }
    }

    /// Information of an odometry edge that ends at this scan and is `length` metres long, as a pose graph takes it: upper triangle row by row. Its covariance
    /// is that of the registration, which is large where the surfaces hold nothing, and that of an edge about which nothing is known: odometry drifts by
    /// more than single registrations say.
    pub fn edge_information(&self, length: f64) -> [f64; 21] {
        let drift = Matrix6::from_diagonal(&Vector6::from(default_information(length).map(f64::recip)));
        let information = (drift + registration_covariance(&self.information)).cholesky().map_or_else(Matrix6::zeros, |whole| whole.inverse());
        upper_triangle(&information)
    }
}

/// Covariance of a registration by its information.
pub(super) fn registration_covariance(information: &Matrix6<f64>) -> Matrix6<f64> {
    let eigen = SymmetricEigen::new(*information);
    let variances = eigen.eigenvalues.map(|value| 1.0 / value.max(LEAST_INFORMATION));
    eigen.eigenvectors * Matrix6::from_diagonal(&variances) * eigen.eigenvectors.transpose()
}

/// Whether a pose can be used.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Status {
    /// The first scan of a piece: its pose is where the piece before was last predicted to be.
    First,
    /// Registered to the local map.
    Tracked,
    /// Registered, but the surfaces do not hold the pose along so many directions; along these it is the prediction.
    Degenerate {
        /// Number of directions, of six.
        directions: usize,
    },
    /// Not registered; the pose is the prediction and the scan did not enter the map.
    Failed(Failure),
}

/// Why a scan was not registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Failure {
    /// The scan has too few returns, as with a covered sensor: hardly any, or far fewer than the scans before.
    TooFewReturns,
    /// Too few of its surfaces have a counterpart in the map, as after a jump of the sensor.
    TooLittleOverlap,
    /// It fits worse than usual, and wherever it fits, its surfaces would be in space that the last scans saw to be free, or theirs in space that it saw
    /// to be free: the sensor is elsewhere.
    InFreeSpace,
    /// The time stamp is before that of the scan before, or not finite. If several in turn are, the clock was set back and a new piece begins.
    TimeNotAscending,
}

impl Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooFewReturns => "too few returns",
            Self::TooLittleOverlap => "it fits nowhere near the last pose",
            Self::InFreeSpace => "wherever it fits, its surfaces would be in space that was observed to be free",
            Self::TimeNotAscending => "its time is not after that of the scan before",
        })
    }
}

/// Wall time by phase.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PhaseTimes {
    /// Range gate, deskew and downsampling.
    pub prepare: Duration,
    /// Registration.
    pub register: Duration,
    /// Update of the local map.
    pub update: Duration,
}
