//! Odometry with the drift of real LiDAR-inertial systems: yaw, scale and slope wander slowly, while roll and pitch are held
//! by gravity and neighbouring scans agree.

use super::information;
use crate::random::Stream;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// Over how many metres drift is stated.
const STRETCH: f64 = 100.0;
/// Metres along which the rates of drift keep their direction.
const MEMORY: f64 = 20.0;
/// Rates of drift of 1 m in 100 m of straight path: the constant part and the wandering part of yaw (radians per metre), scale
/// and slope (per metre).
const YAW: (f64, f64) = (7e-5, 1.2e-4);
const SCALE: (f64, f64) = (4e-3, 2e-3);
const SLOPE: (f64, f64) = (2e-3, 2e-3);
/// Roll and pitch error, radians, which gravity keeps from growing.
const TILT: f64 = 2.5e-4;

/// A number that wanders about zero with unit variance and forgets itself over [`MEMORY`] metres.
struct Wander {
    value: f64,
}

impl Wander {
    fn new(random: &mut Stream) -> Self {
        Self { value: random.normal() }
    }

    fn step(&mut self, metres: f64, random: &mut Stream) -> f64 {
        let keep = (-metres / MEMORY).exp();
        self.value = keep * self.value + (1.0 - keep * keep).sqrt() * random.normal();
        self.value
    }
}

/// The trajectory as drifting odometry would have it, beginning at the true first pose. It drifts by `rate` metres in 100 m of
/// path on average over all stretches of this very trajectory (half its length if it is shorter than 200 m).
pub(crate) fn drifted(truth: &[Pose], rate: f64, random: &Stream) -> Vec<Pose> {
    if rate <= 0.0 {
        return truth.to_vec();
    }
    // Drift is very nearly proportional to the rates, so that a few corrections of the factor reach the wanted one.
    let mut factor = rate;
    let mut odometry = with_rates(truth, factor, random.clone());
    for _ in 0..6 {
        match drift_of(truth, &odometry) {
            Some(drift) if drift > 1e-9 => factor *= (rate / drift).clamp(0.2, 5.0),
            _ => break,
        }
        odometry = with_rates(truth, factor, random.clone());
    }
    odometry
}

fn with_rates(truth: &[Pose], factor: f64, mut random: Stream) -> Vec<Pose> {
    let random = &mut random;
    let bias = [YAW.0 * random.normal(), SCALE.0 * random.normal(), SLOPE.0 * random.normal()];
    let mut wander: [Wander; 5] = std::array::from_fn(|_| Wander::new(random));
    let mut odometry: Vec<Pose> = truth.first().copied().into_iter().collect();
    let (mut yaw, mut place) = (0.0, odometry.first().map_or(Vector3::zeros(), |p| p.translation.vector));
    for pair in truth.windows(2) {
        let step = pair[1].translation.vector - pair[0].translation.vector;
        let metres = step.norm();
        let [yawing, scaling, sloping, rolling, pitching] = std::array::from_fn(|k| wander[k].step(metres, random));
        let turn = factor * (bias[0] + YAW.1 * yawing) * metres;
        let scale = factor * (bias[1] + SCALE.1 * scaling);
        let slope = factor * (bias[2] + SLOPE.1 * sloping);
        let tilt = TILT * factor.min(1.0);
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw + 0.5 * turn);
        place += heading * step * (1.0 + scale) + Vector3::z() * (slope * metres);
        yaw += turn;
        let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * pair[1].rotation;
        let tilted = turned * UnitQuaternion::from_euler_angles(tilt * rolling, tilt * pitching, 0.0);
        odometry.push(Pose::from_parts(Translation3::from(place), tilted));
    }
    odometry
}

/// Mean drift of a trajectory against the true one, metres in 100 m of path: how far the end of a stretch is off when its
/// beginning is laid on the truth, over all stretches of 100 m (or half the trajectory, if that is shorter). `None` for a
/// trajectory without length, or when the two differ in number.
pub fn drift_of(truth: &[Pose], estimate: &[Pose]) -> Option<f64> {
    if truth.len() != estimate.len() {
        return None;
    }
    let travelled = path_lengths(truth);
    let total = travelled.last().copied().unwrap_or(0.0);
    let stretch = STRETCH.min(total / 2.0);
    let mut errors = Vec::new();
    for (i, start) in travelled.iter().enumerate() {
        let j = travelled.partition_point(|s| s - start < stretch - 1e-9);
        if stretch > 0.0 && j < truth.len() {
            let (moved, believed) = (truth[i].inv_mul(&truth[j]), estimate[i].inv_mul(&estimate[j]));
            errors.push((moved.translation.vector - believed.translation.vector).norm());
        }
    }
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64 * (STRETCH / stretch))
}

/// Path length from the first pose to each, metres.
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

/// The edges between neighbouring nodes, as measured, with what the odometry believes of its own errors.
pub(crate) fn edges(odometry: &[Pose], rate: f64) -> Vec<Edge> {
    (0 as NodeId..)
        .zip(odometry.windows(2))
        .map(|(node, pair)| {
            let t_from_to = pair[0].inv_mul(&pair[1]);
            let metres = t_from_to.translation.vector.norm();
            let place = 0.002 + 0.006 * rate * metres;
            let yaw = 2e-4 + 2e-4 * rate * metres;
            let information = information([place, place, place, TILT, TILT, yaw]);
            Edge { from: node, to: node + 1, t_from_to, information: Some(information) }
        })
        .collect()
}
