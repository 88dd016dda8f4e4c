//! Beams meet what moves where it is at their time.

use nalgebra::{Translation3, UnitQuaternion};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::sensor::preset_with_columns;
use voxelastic_sim::random::Stream;
use voxelastic_sim::route::Route;
use voxelastic_sim::sensor::{Lidar, LidarSettings, Noise};
use voxelastic_sim::traffic::{Body, Course, Label, Traffic};
use voxelastic_sim::{Scene, WorldBuilder};

fn lidar(moving: bool) -> Lidar {
    let model = preset_with_columns("os1-64", 512).unwrap();
    Lidar::new(model, LidarSettings { moving, noise: Noise::none(), ..LidarSettings::default() }).unwrap()
}

/// A ball of 1 m radius that moves along a circle of 40 m at 10 m/s.
fn ball() -> Body {
    let mut b = WorldBuilder::new("ball", 1);
    b.sphere([0.0, 0.0, 1.0], 1.0, 0.5);
    let course = Course::Along { route: Route::rounded(&[], 40.0), left: 30.0, start: 0.0, speed: 10.0, departs: 0.0 };
    Body { shape: Arc::new(b.build().unwrap()), course }
}

#[test]
fn points_of_a_moving_ball_lie_on_it_at_their_own_time() {
    let traffic = Traffic { bodies: vec![ball()] };
    let world = WorldBuilder::new("nothing", 1).build().unwrap();
    let pose = |t: f64| Pose::from_parts(Translation3::new(2.0 * t, 0.0, 1.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 1.5 * t));
    let cloud = lidar(true).scan(traffic.within(&world, 3.0), |offset| pose(3.0 + offset), &Stream::new(1, &[]));
    let (mut met, mut largest) = (0, 0.0f64);
    for (point, time) in cloud.points.iter().zip(cloud.time.as_ref().unwrap()).filter(|(p, _)| p[0].is_finite()) {
        let time = 3.0 + f64::from(*time);
        let p = pose(time) * nalgebra::Point3::from(point.map(f64::from));
        let ([x, y], _) = traffic.bodies[0].at(time);
        let off = (p - nalgebra::Point3::new(x, y, 1.0)).norm() - 1.0;
        (met, largest) = (met + 1, largest.max(off.abs()));
    }
    assert!(met > 100 && largest < 1e-4, "{met} points, off by {largest} m");
    let still = lidar(false).scan(traffic.within(&world, 3.0), |_| pose(3.0), &Stream::new(1, &[]));
    assert!(still.points.iter().filter(|p| p[0].is_finite()).count() > 100);
}

#[test]
fn a_body_hides_the_world_and_without_bodies_nothing_changes() {
    let scene = Scene::named("street", 1).unwrap();
    let pose = |t: f64| scene.trajectory.pose(t);
    let alone = lidar(true).scan(&scene.world, pose, &Stream::new(4, &[]));
    let none = Traffic::default();
    let bits = |cloud: &voxelastic::Cloud| cloud.points.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&alone), bits(&lidar(true).scan(none.within(&scene.world, 0.0), pose, &Stream::new(4, &[]))));
    let traffic = Traffic::along(&scene, 10, 1).unwrap();
    let among = lidar(true).scan(traffic.within(&scene.world, 0.0), pose, &Stream::new(4, &[]));
    let range = |p: &[f32; 3]| p.iter().map(|v| v * v).sum::<f32>().sqrt();
    let pairs = || alone.points.iter().zip(&among.points).filter(|(a, b)| a[0].is_finite() && b[0].is_finite());
    assert!(pairs().all(|(a, b)| range(b) <= range(a) + 1e-3), "nothing is seen through a body");
    assert!(pairs().filter(|(a, b)| range(b) < range(a) - 0.5).count() > 50);
    let again = Traffic::along(&scene, 10, 1).unwrap();
    assert!(traffic.bodies.iter().zip(&again.bodies).all(|(a, b)| a.at(7.0) == b.at(7.0)));
}

#[test]
fn points_are_labelled_by_what_they_are_on() {
    let scene = Scene::named("street", 1).unwrap();
    let traffic = Traffic::along(&scene, 12, 1).unwrap();
    let label = |k: usize, time: f64| traffic.bodies[k].label(time);
    // The fifth stands and leaves, the sixth turns and stands again.
    assert_eq!([label(4, 0.0), label(4, 60.0), label(5, 0.0), label(5, 60.0), label(0, 0.0)], {
        use Label::{Moving, Resting, Settled};
        [Resting, Moving, Resting, Settled, Moving]
    });
    let (_, closed) = traffic.bodies[5].at(0.0);
    let (_, open) = traffic.bodies[5].at(60.0);
    assert!((open - closed - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    let pose = scene.trajectory.pose(0.0);
    let lidar = lidar(false);
    let (among, labels) = lidar.labelled_scan(traffic.within(&scene.world, 0.0), |_| pose, &Stream::new(4, &[]));
    let alone = lidar.scan(&scene.world, |_| pose, &Stream::new(4, &[]));
    let range = |p: &[f32; 3]| p.iter().map(|v| v * v).sum::<f32>().sqrt();
    let mut counts = [0; 4];
    for ((a, b), label) in alone.points.iter().zip(&among.points).zip(&labels) {
        counts[usize::from(*label)] += usize::from(b[0].is_finite());
        let is_hidden = b[0].is_finite() && (!a[0].is_finite() || range(b) < range(a) - 1e-3);
        assert!(*label == 0 || is_hidden, "a labelled point is nearer than the world");
        assert!(*label != 0 || !is_hidden, "a point before the world is labelled");
    }
    assert!(counts[..3].iter().all(|&count| count > 5), "{counts:?}");
}
