//! Dead reckoning with an inertial measurement unit between two scans, and what the scans say about its biases.
//!
//! The rotation follows from the angular velocity, the translation from the specific force turned into the map frame, less gravity, on top of the
//! velocity. After each registration, the pose that was measured corrects the velocity and, slowly, the bias of the angular velocity and the
//! specific force at rest: an observer of fixed gains, as in rko_lio (PRBonn) without a noise model.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use voxelastic::geometry::Pose;
use voxelastic::geometry::stored::StoredVector;
use voxelastic::motion::{ImuSample, Motion};

/// Longest gap between samples that is bridged, seconds.
const LONGEST_GAP: f64 = 0.1;
/// The newest sample holds for this long, seconds.
const HOLD: f64 = 0.03;
/// Samples older than this before the newest are dropped, seconds.
const HISTORY: f64 = 5.0;
/// Steps of a motion during a sweep, seconds.
const STEP: f64 = 0.005;
const MOST_STEPS: usize = 400;
/// Standard gravity, metres per square second.
pub(super) const GRAVITY: f64 = 9.81;
/// A unit that measures gravity to within this much and turns by no more than this is at rest: metres per square second, radians per second,
/// both root mean square around their means.
const REST: (f64, f64) = (0.15, 0.03);
/// Biases of more than this are none, radians per second.
const LARGEST_BIAS: f64 = 0.1;
/// Samples that are needed to say that the sensor is at rest.
const LEAST_AT_REST: usize = 8;
/// What share of a deviation from the prediction corrects the velocity, the bias of the angular velocity and the force at rest.
const VELOCITY_GAIN: f64 = 0.5;
const GYRO_GAIN: f64 = 0.03;
const FORCE_GAIN: f64 = 0.01;
/// How many corrections by scans a bias measured at rest is worth.
const WORTH_OF_REST: usize = 15;
/// Scans between which nothing is learned about the unit are farther apart than this, seconds.
const LONGEST_STEP: f64 = 0.5;

/// What the unit's samples and the scans say together.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(from = "StoredInertial", into = "StoredInertial")]
pub(crate) struct Inertial {
    samples: VecDeque<ImuSample>,
    gyro_bias: Vector3<f64>,
    /// Scans that corrected the bias.
    corrections: usize,
    /// What the unit measures at rest, map frame: against gravity, with the bias of the force.
    force_at_rest: Option<Vector3<f64>>,
    /// Velocity of the lidar at the last scan, map frame.
    velocity: Option<Vector3<f64>>,
}

/// The serialised form.
#[derive(Serialize, Deserialize)]
struct StoredInertial {
    samples: VecDeque<ImuSample>,
    gyro_bias: StoredVector,
    corrections: usize,
    force_at_rest: Option<StoredVector>,
    velocity: Option<StoredVector>,
}

impl From<Inertial> for StoredInertial {
    fn from(Inertial { samples, gyro_bias, corrections, force_at_rest, velocity }: Inertial) -> Self {
        let [force_at_rest, velocity] = [force_at_rest, velocity].map(|vector| vector.map(StoredVector::from));
        Self { samples, gyro_bias: gyro_bias.into(), corrections, force_at_rest, velocity }
    }
}

impl From<StoredInertial> for Inertial {
    fn from(StoredInertial { samples, gyro_bias, corrections, force_at_rest, velocity }: StoredInertial) -> Self {
        let [force_at_rest, velocity] = [force_at_rest, velocity].map(|vector| vector.map(Vector3::from));
        Self { samples, gyro_bias: gyro_bias.into(), corrections, force_at_rest, velocity }
    }
}

/// Position, velocity and rotation of the lidar, map frame.
#[derive(Clone, Copy, Debug)]
struct State {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
}

impl Inertial {
    /// Adds a sample. Those that are not finite or not newer than the last are dropped; one that is far older than the last begins anew.
    pub(crate) fn add(&mut self, sample: ImuSample) {
        let is_newer = self.samples.back().is_none_or(|last| sample.time > last.time);
        let is_finite = sample.time.is_finite() && sample.angular_velocity.iter().chain(&sample.acceleration).all(|v| v.is_finite());
        if self.samples.back().is_some_and(|last| sample.time < last.time - 1.0) && is_finite {
            // The clock was set back.
            self.samples.clear();
            self.samples.push_back(sample);
        } else if is_newer && is_finite {
            self.samples.push_back(sample);
        }
        while self.samples.front().zip(self.samples.back()).is_some_and(|(first, last)| first.time < last.time - HISTORY) {
            self.samples.pop_front();
        }
    }

    /// Rotation from the frame at `from` to that at `to`, if samples cover the interval without gaps.
    pub(crate) fn rotation(&self, from: f64, to: f64) -> Option<UnitQuaternion<f64>> {
        let mut state = State { position: Vector3::zeros(), velocity: Vector3::zeros(), rotation: UnitQuaternion::identity() };
        self.walk(from, to, &mut state).then_some(state.rotation)
    }

    /// The unit's reading at a time between two samples.
    fn at(&self, time: f64) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let after = self.samples.partition_point(|s| s.time < time);
        let vectors = |s: &ImuSample| (Vector3::from(s.angular_velocity), Vector3::from(s.acceleration));
        let Some(b) = self.samples.get(after) else {
            return self.samples.back().filter(|last| time - last.time <= HOLD).map(vectors);
        };
        let Some(a) = after.checked_sub(1).and_then(|before| self.samples.get(before)) else {
            return (b.time - time <= HOLD).then(|| vectors(b));
        };
        if b.time - a.time > LONGEST_GAP {
            return None;
        }
        let share = (time - a.time) / (b.time - a.time);
        let ((wa, fa), (wb, fb)) = (vectors(a), vectors(b));
        Some((wa.lerp(&wb, share), fa.lerp(&fb, share)))
    }

    /// Integrates from one time to another, forwards or backwards; false if samples are missing.
    fn walk(&self, from: f64, to: f64, state: &mut State) -> bool {
        let (low, high) = (from.min(to), from.max(to));
        let first = self.samples.partition_point(|s| s.time <= low);
        let last = self.samples.partition_point(|s| s.time < high);
        let between = |k: usize| self.samples[k].time;
        let count = last.saturating_sub(first);
        let mut time = from;
        for k in 0..=count {
            let next = match k {
                k if k == count => to,
                k if from <= to => between(first + k),
                k => between(last - 1 - k),
            };
            if next != time && !self.step(time, next, state) {
                return false;
            }
            time = next;
        }
        from != to || self.at(from).is_some()
    }

    /// One step between two neighbouring samples.
    fn step(&self, from: f64, to: f64, state: &mut State) -> bool {
        let Some((rate, force)) = self.at(0.5 * (from + to)) else { return false };
        let step = to - from;
        let turn = |share: f64| UnitQuaternion::from_scaled_axis((rate - self.gyro_bias) * (share * step));
        let acceleration = self.force_at_rest.map_or(Vector3::zeros(), |rest| state.rotation * turn(0.5) * force - rest);
        state.position += state.velocity * step + acceleration * (0.5 * step * step);
        state.velocity += acceleration * step;
        state.rotation *= turn(1.0);
        true
    }

    /// The pose at `to`, from that of the scan at `from`; `None` where samples are missing or the velocity is not known.
    pub(crate) fn predict(&self, t_map_lidar: &Pose, from: f64, to: f64) -> Option<Pose> {
        let state = self.state_after(t_map_lidar, from, to)?;
        Some(Pose::from_parts(state.position.into(), state.rotation))
    }

    fn state_after(&self, t_map_lidar: &Pose, from: f64, to: f64) -> Option<State> {
        let velocity = self.velocity.filter(|_| self.force_at_rest.is_some())?;
        let mut state = State { position: t_map_lidar.translation.vector, velocity, rotation: t_map_lidar.rotation };
        self.walk(from, to, &mut state).then_some(state)
    }

    /// The motion of the lidar from `begin` to `end`, seconds after the time stamp `time`, where it had this pose and velocity (map frame).
    pub(crate) fn sweep(&self, t_map_lidar: &Pose, velocity: Vector3<f64>, time: f64, [begin, end]: [f64; 2]) -> Option<Motion> {
        let start = State { position: Vector3::zeros(), velocity, rotation: t_map_lidar.rotation };
        let inwards = t_map_lidar.rotation.inverse();
        let relative = |state: &State| Pose::from_parts((inwards * state.position).into(), inwards * state.rotation);
        let towards = |to: f64| -> Option<Vec<(f32, Pose)>> {
            let count = ((to.abs() / STEP).ceil() as usize).clamp(1, MOST_STEPS);
            let (mut state, mut at) = (start, 0.0);
            let mut poses = Vec::with_capacity(count);
            for k in 1..=count {
                let next = to * k as f64 / count as f64;
                if !self.walk(time + at, time + next, &mut state) {
                    return None;
                }
                at = next;
                poses.push((next as f32, relative(&state)));
            }
            Some(poses)
        };
        let mut samples = if begin < 0.0 { towards(begin)? } else { Vec::new() };
        samples.reverse();
        samples.push((0.0, Pose::identity()));
        if end > 0.0 {
            samples.extend(towards(end)?);
        }
        Motion::through(samples)
    }

    /// Sum of the specific force from one time to another, map frame, metres per second, where the lidar had this pose at the first.
    pub(crate) fn impulse(&self, t_map_lidar: &Pose, from: f64, to: f64) -> Option<Vector3<f64>> {
        let rest = self.force_at_rest?;
        let mut state = State { position: Vector3::zeros(), velocity: Vector3::zeros(), rotation: t_map_lidar.rotation };
        self.walk(from, to, &mut state).then(|| state.velocity + rest * (to - from))
    }

    /// Velocity at the end of a prediction from the scan at `from`, corrected by the pose that was measured; map frame.
    pub(crate) fn corrected_velocity(&self, last: &Pose, measured: &Pose, from: f64, to: f64) -> Option<Vector3<f64>> {
        let state = self.state_after(last, from, to)?;
        let deviation = measured.translation.vector - state.position;
        Some(state.velocity + deviation * (VELOCITY_GAIN / (to - from).abs().max(1e-3)))
    }

    /// Begins at the first scan of a piece: if the samples from `from` to `to` say that the sensor rests, its velocity is zero, the mean angular velocity
    /// the bias, and the mean force that against gravity. `t_map_lidar` is its pose. Returns whether it rests.
    pub(crate) fn begin(&mut self, t_map_lidar: &Pose, to: f64) -> bool {
        self.velocity = None;
        let Some((rate, force, is_at_rest)) = self.means(to) else { return false };
        self.force_at_rest = Some(t_map_lidar.rotation * force);
        if is_at_rest {
            (self.velocity, self.gyro_bias) = (Some(Vector3::zeros()), rate);
            self.corrections = WORTH_OF_REST;
        }
        is_at_rest
    }

    /// Means of the samples so far, up to a time, and whether they are those of a sensor at rest.
    fn means(&self, to: f64) -> Option<(Vector3<f64>, Vector3<f64>, bool)> {
        let samples = || self.samples.iter().filter(|s| s.time <= to + HOLD);
        let count = samples().count();
        if count < LEAST_AT_REST {
            return None;
        }
        let mean = |of: fn(&ImuSample) -> [f64; 3]| samples().map(|s| Vector3::from(of(s))).sum::<Vector3<f64>>() / count as f64;
        let (rate, force) = (mean(|s| s.angular_velocity), mean(|s| s.acceleration));
        let off = |of: fn(&ImuSample) -> [f64; 3], mean: &Vector3<f64>| {
            (samples().map(|s| (Vector3::from(of(s)) - mean).norm_squared()).sum::<f64>() / count as f64).sqrt()
        };
        let is_at_rest = off(|s| s.acceleration, &force) < REST.0
            && off(|s| s.angular_velocity, &rate) < REST.1
            && rate.norm() < LARGEST_BIAS
            && (force.norm() - GRAVITY).abs() < 0.05 * GRAVITY;
        Some((rate, force, is_at_rest))
    }

    /// The direction against gravity in the lidar frame at the first scan, if the samples up to a time say it: at rest.
    pub(crate) fn up(&self, to: f64) -> Option<Vector3<f64>> {
        self.means(to).filter(|(_, _, is_at_rest)| *is_at_rest).map(|(_, force, _)| force.normalize())
    }

    /// Takes over what a registration says: the pose at `to`, where the one at `from` was `last`.
    pub(crate) fn correct(&mut self, last: &Pose, measured: &Pose, from: f64, to: f64) {
        let seconds = to - from;
        if self.samples.is_empty() || seconds <= 0.0 {
            return;
        }
        let Some(rotation) = self.rotation(from, to).filter(|_| seconds <= LONGEST_STEP) else {
            self.velocity = None;
            return;
        };
        let velocity = self.corrected_velocity(last, measured, from, to);
        if let (Some(state), Some(rest)) = (self.state_after(last, from, to), &mut self.force_at_rest) {
            let deviation = measured.translation.vector - state.position;
            *rest -= deviation * (FORCE_GAIN * 2.0 / (seconds * seconds));
        }
        // Without a velocity yet: the mean over the interval.
        self.velocity = velocity.or_else(|| Some((measured.translation.vector - last.translation.vector) / seconds));
        let turned = (last.rotation * rotation).inverse() * measured.rotation;
        self.corrections += 1;
        let gain = GYRO_GAIN.max(0.5 / (self.corrections as f64 + 1.0));
        let bias = self.gyro_bias - turned.scaled_axis() * (gain / seconds);
        if bias.norm() < LARGEST_BIAS {
            self.gyro_bias = bias;
        }
    }
}
