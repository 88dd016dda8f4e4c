//! The unit's samples, integrated, give back the motion.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic::motion::ImuSample;
use voxelastic_sim::imu::{GRAVITY, Imu, ImuSettings};
use voxelastic_sim::random::Stream;
use voxelastic_sim::route::{Carrier, Route, Trajectory};

fn handheld(rest: f64) -> Trajectory {
    Trajectory { route: Route::rounded(&[[0.0, 0.0], [30.0, 0.0], [30.0, 20.0]], 3.0), carrier: Carrier::HANDHELD, rest }
}

/// Dead reckoning from a known pose and velocity: each sample holds for half a step before and after its time.
fn integrate(samples: &[ImuSample], start: Pose, velocity: Vector3<f64>, step: f64) -> Vec<Pose> {
    let mut pose = start;
    let mut velocity = velocity;
    let mut poses = vec![pose];
    for pair in samples.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        let half = |s: &ImuSample| UnitQuaternion::from_scaled_axis(Vector3::from(s.angular_velocity) * (0.5 * step));
        let next = pose.rotation * half(a) * half(b);
        let force = |rotation: &UnitQuaternion<f64>, s: &ImuSample| rotation * Vector3::from(s.acceleration) - Vector3::z() * GRAVITY;
        let (first, second) = (force(&pose.rotation, a), force(&next, b));
        pose.translation.vector += velocity * step + (first * 2.0 + second) * (step * step / 6.0);
        velocity += (first + second) * (0.5 * step);
        pose.rotation = next;
        poses.push(pose);
    }
    poses
}

#[test]
fn exact_samples_give_back_the_trajectory() {
    let trajectory = handheld(0.0);
    let step = 1.0 / 200.0;
    let samples = Imu::new(ImuSettings::exact(200.0)).samples(8.0, |t| trajectory.pose(t), &Stream::new(1, &[]));
    assert_eq!(samples.len(), 1601);
    let velocity = (trajectory.pose(1e-5).translation.vector - trajectory.pose(-1e-5).translation.vector) / 2e-5;
    let poses = integrate(&samples, trajectory.pose(0.0), velocity, step);
    for (pose, sample) in poses.iter().zip(&samples) {
        let truth = trajectory.pose(sample.time);
        assert!(pose.rotation_distance(&truth) < 2e-3, "{} rad at {} s", pose.rotation_distance(&truth), sample.time);
        assert!(pose.translation_distance(&truth) < 0.06, "{} m at {} s", pose.translation_distance(&truth), sample.time);
    }
}

#[test]
fn at_rest_it_measures_gravity_and_its_biases() {
    let trajectory = handheld(20.0);
    let settings = ImuSettings::default();
    let imu = Imu::new(settings);
    let samples = imu.samples(20.0 - 0.01, |t| trajectory.pose(t), &Stream::new(2, &[]));
    let mean = |of: fn(&ImuSample) -> [f64; 3]| samples.iter().map(|s| Vector3::from(of(s))).sum::<Vector3<f64>>() / samples.len() as f64;
    let (rate, force) = (mean(|s| s.angular_velocity), mean(|s| s.acceleration));
    let t_world_imu = trajectory.pose(0.0) * imu.t_lidar_imu();
    let gravity = t_world_imu.rotation.inverse() * Vector3::z() * GRAVITY;
    assert!((force - gravity).amax() < 4.0 * settings.accelerometer_bias, "{force}");
    assert!(rate.norm() > 1e-3 && rate.amax() < 4.0 * settings.gyro_bias, "the bias is all there is: {rate}");
    let off = |k: usize| samples.iter().map(|s| (s.angular_velocity[k] - rate[k]).powi(2)).sum::<f64>() / samples.len() as f64;
    let sigma = settings.gyro_noise * settings.rate.sqrt();
    assert!((0..3).all(|k| (off(k).sqrt() / sigma - 1.0).abs() < 0.1), "noise of {sigma}");
}

#[test]
fn a_unit_beside_the_axis_feels_the_turn() {
    // Two turns per second about z, 0.1 m beside the axis: w^2 r towards it.
    let turning = |t: f64| Pose::from_parts(Translation3::identity(), UnitQuaternion::from_euler_angles(0.0, 0.0, 4.0 * t));
    let imu = Imu::new(ImuSettings { position: [0.1, 0.0, 0.0], ..ImuSettings::exact(1000.0) });
    let samples = imu.samples(1.0, turning, &Stream::new(1, &[]));
    for s in samples {
        assert!((s.angular_velocity[2] - 4.0).abs() < 1e-9);
        assert!((Vector3::from(s.acceleration) - Vector3::new(-1.6, 0.0, GRAVITY)).norm() < 1e-3, "{s:?}");
    }
}
