//! Odometry with the drift of LiDAR-inertial systems: errors of yaw rate, scale and slope vary slowly, roll and pitch are bounded by gravity, and
//! consecutive poses are consistent.

use super::gaussian::information;
use crate::random::Stream;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// Path length over which drift is measured, metres.
const DRIFT_LENGTH: f64 = 100.0;
/// Correlation length of the drift rates, metres.
const CORRELATION_LENGTH: f64 = 20.0;
/// Drift rates for about 1 m in 100 m of straight path, constant and random part: yaw, radians per metre.
const YAW: (f64, f64) = (7e-5, 1.2e-4);
/// Scale, per metre.
const SCALE: (f64, f64) = (4e-3, 2e-3);
/// Slope, per metre.
const SLOPE: (f64, f64) = (2e-3, 2e-3);
/// Standard deviation of roll and pitch, radians; gravity bounds them.
const TILT: f64 = 2.5e-4;

/// A first-order Gauss-Markov process of zero mean and unit variance with a correlation length of [`CORRELATION_LENGTH`].
#[derive(Clone, Debug)]
struct GaussMarkov {
    value: f64,
}

impl GaussMarkov {
    fn new(random: &mut Stream) -> Self {
        Self { value: random.normal() }
    }

    fn step(&mut self, metres: f64, random: &mut Stream) -> f64 {
        let keep = (-metres / CORRELATION_LENGTH).exp();
        self.value = keep * self.value + (1.0 - keep * keep).sqrt() * random.normal();
        self.value
    }
}

/// Odometry that starts at the true first pose and drifts by `rate` metres in 100 m of path, by the measure of [`mean_drift`].
pub(crate) fn drifting_odometry(truth: &[Pose], rate: f64, random: &Stream) -> Vec<Pose> {
    if rate <= 0.0 {
        return truth.to_vec();
    }
    // Drift is nearly proportional to the rates, so a few corrections of the factor suffice.
    let mut factor = rate;
    let mut odometry = with_rates(truth, factor, random.clone());
    for _ in 0..6 {
        match mean_drift(truth, &odometry) {
            Some(drift) if drift > 1e-9 => factor *= (rate / drift).clamp(0.2, 5.0),
            _ => break,
        }
        odometry = with_rates(truth, factor, random.clone());
    }
    odometry
}

/// Drift of an odometry, pose by pose.
#[derive(Clone, Debug)]
pub(super) struct OdometryDrift {
    factor: f64,
    random: Stream,
    bias: [f64; 3],
    processes: [GaussMarkov; 5],
    yaw: f64,
    position: Vector3<f64>,
}

impl OdometryDrift {
    /// Drift of about `factor` metres in 100 m of straight path.
    pub fn new(factor: f64, mut random: Stream) -> Self {
        let bias = [YAW.0 * random.normal(), SCALE.0 * random.normal(), SLOPE.0 * random.normal()];
        let processes = std::array::from_fn(|_| GaussMarkov::new(&mut random));
        Self { factor, random, bias, processes, yaw: 0.0, position: Vector3::zeros() }
    }

    /// Starts at the true pose.
    pub fn start(&mut self, truth: &Pose) {
        self.position = truth.translation.vector;
    }

    /// The odometry's pose after a true motion.
    pub fn step(&mut self, before: &Pose, after: &Pose) -> Pose {
        let Self { factor, random, bias, processes, .. } = self;
        let step = after.translation.vector - before.translation.vector;
        let metres = step.norm();
        let [yawing, scaling, sloping, rolling, pitching] = std::array::from_fn(|k| processes[k].step(metres, random));
        let turn = *factor * (bias[0] + YAW.1 * yawing) * metres;
        let scale = *factor * (bias[1] + SCALE.1 * scaling);
        let slope = *factor * (bias[2] + SLOPE.1 * sloping);
        let tilt = TILT * factor.min(1.0);
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw + 0.5 * turn);
        self.position += heading * step * (1.0 + scale) + Vector3::z() * (slope * metres);
        self.yaw += turn;
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw) * after.rotation;
        let tilted = turned * UnitQuaternion::from_euler_angles(tilt * rolling, tilt * pitching, 0.0);
        Pose::from_parts(Translation3::from(self.position), tilted)
    }
}

fn with_rates(truth: &[Pose], factor: f64, random: Stream) -> Vec<Pose> {
    let mut drift = OdometryDrift::new(factor, random);
    let mut odometry: Vec<Pose> = truth.first().copied().into_iter().collect();
    odometry.iter().for_each(|first| drift.start(first));
    odometry.extend(truth.windows(2).map(|pair| drift.step(&pair[0], &pair[1])));
    odometry
}

/// Mean drift of a trajectory, metres in 100 m of path: the error of the end of a span whose start is aligned with the truth, over all spans of 100 m
/// (or half the trajectory, if that is shorter). `None` for a trajectory of zero length, or if the numbers of poses differ.
pub fn mean_drift(truth: &[Pose], estimate: &[Pose]) -> Option<f64> {
    if truth.len() != estimate.len() {
        return None;
    }
    let travelled = path_lengths(truth);
    let total = travelled.last().copied().unwrap_or(0.0);
    let span = DRIFT_LENGTH.min(total / 2.0);
    let mut errors = Vec::new();
    for (i, start) in travelled.iter().enumerate() {
        let j = travelled.partition_point(|s| s - start < span - 1e-9);
        if span > 0.0 && j < truth.len() {
            let (true_motion, estimated) = (truth[i].inv_mul(&truth[j]), estimate[i].inv_mul(&estimate[j]));
            errors.push((true_motion.translation.vector - estimated.translation.vector).norm());
        }
    }
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64 * (DRIFT_LENGTH / span))
}

/// Path length up to each pose, metres.
pub(crate) fn path_lengths(poses: &[Pose]) -> Vec<f64> {
    let mut travelled = 0.0;
    (0..poses.len())
        .map(|k| {
            if k > 0 {
                travelled += (poses[k].translation.vector - poses[k - 1].translation.vector).norm();
            }
            travelled
        })
        .collect()
}

/// Edges between consecutive nodes as measured by odometry, with the odometry's estimate of its own errors.
pub(crate) fn edges(odometry: &[Pose], rate: f64) -> Vec<Edge> {
    (0 as NodeId..)
        .zip(odometry.windows(2))
        .map(|(node, pair)| {
            let t_from_to = pair[0].inv_mul(&pair[1]);
            let metres = t_from_to.translation.vector.norm();
            let translation = 0.002 + 0.006 * rate * metres;
            let yaw = 2e-4 + 2e-4 * rate * metres;
            let information = information([translation, translation, translation, TILT, TILT, yaw]);
            Edge { from: node, to: node + 1, t_from_to, information: Some(information) }
        })
        .collect()
}
