//! Samples of an inertial measurement unit, moved to the lidar.

use nalgebra::Vector3;
use voxelastic::Pose;
use voxelastic::motion::ImuSample;

/// Some drivers (Livox) give accelerations in units of gravity; nothing that carries a lidar begins in free fall.
const LARGEST_IN_G: f64 = 3.0;
const STANDARD_GRAVITY: f64 = 9.806_65;
/// Samples farther apart than this say nothing about the angular acceleration, seconds.
const LONGEST_GAP_S: f64 = 0.05;

/// Where a unit is, and what it measured last.
#[derive(Clone, Debug)]
pub(crate) struct ImuMount {
    t_lidar_imu: Pose,
    /// Factor that makes metres per square second of its accelerations; known with the first sample.
    scale: Option<f64>,
    /// Time and angular velocity of the last sample, lidar axes.
    last: Option<(f64, Vector3<f64>)>,
}

impl ImuMount {
    pub(crate) fn new(t_lidar_imu: Pose) -> Self {
        Self { t_lidar_imu, scale: None, last: None }
    }

    /// What a unit at the lidar's origin with the lidar's axes would have measured.
    pub(crate) fn at_lidar(&mut self, sample: ImuSample) -> ImuSample {
        let turn = &self.t_lidar_imu.rotation;
        let rate = turn * Vector3::from(sample.angular_velocity);
        let force = Vector3::from(sample.acceleration);
        let scale = *self.scale.get_or_insert_with(|| if force.norm() < LARGEST_IN_G { STANDARD_GRAVITY } else { 1.0 });
        let spin_up = match self.last {
            Some((time, before)) if sample.time > time && sample.time - time <= LONGEST_GAP_S => (rate - before) / (sample.time - time),
            _ => Vector3::zeros(),
        };
        self.last = Some((sample.time, rate));
        // The unit is carried around the lidar: it feels the turn and its change, the lidar does not.
        let arm = self.t_lidar_imu.translation.vector;
        let carried = spin_up.cross(&arm) + rate.cross(&rate.cross(&arm));
        ImuSample { time: sample.time, angular_velocity: rate.into(), acceleration: (turn * force * scale - carried).into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn a_unit_beside_the_axis_of_a_turn_feels_what_the_lidar_does_not() {
        // The lidar turns at 4 rad/s on the spot; the unit is 0.1 m ahead of it, turned by half a turn, and counts in g.
        let pose = Pose::from_parts([0.1, 0.0, 0.0].into(), UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::PI));
        let mut mount = ImuMount::new(pose);
        let centripetal = 1.6 / STANDARD_GRAVITY;
        let mut at = |time: f64| mount.at_lidar(ImuSample { time, angular_velocity: [0.0, 0.0, 4.0], acceleration: [centripetal, 0.0, 1.0] });
        for sample in [at(0.0), at(0.01), at(0.5)] {
            assert!((Vector3::from(sample.angular_velocity) - Vector3::new(0.0, 0.0, 4.0)).norm() < 1e-12);
            assert!((Vector3::from(sample.acceleration) - Vector3::new(0.0, 0.0, STANDARD_GRAVITY)).norm() < 1e-9, "{sample:?}");
        }
    }
}
