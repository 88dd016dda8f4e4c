//! Motion compensation: the map of a lidar that moves at 3 m/s and rotates at 90 degrees per second is as accurate as that of a lidar that stands still
//! for each scan.

use nalgebra::{Translation3, UnitQuaternion};
use std::f64::consts::FRAC_PI_2;
use voxelastic::event::{Event, Scan};
use voxelastic::sensor::preset_with_columns;
use voxelastic::surface::MeshOptions;
use voxelastic::{Cloud, Mapper, Motion, Pose, Settings};
use voxelastic_sim::Scene;
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};

const SCANS: usize = 24;

/// 3 m/s along a circle with a period of four seconds: 90 degrees per second.
fn circle_pose(t: f64) -> Pose {
    let angle = FRAC_PI_2 * t;
    let radius = 3.0 / FRAC_PI_2;
    let translation = Translation3::new(radius * angle.sin(), radius * (1.0 - angle.cos()), 1.6);
    Pose::from_parts(translation, UnitQuaternion::from_euler_angles(0.0, 0.0, angle))
}

/// Sorted distances of the vertices of a map's mesh to the true surface, metres.
fn errors(scene: &Scene, moving: bool, with_motion: bool) -> Vec<f64> {
    let model = preset_with_columns("os1-64", 512).unwrap();
    let lidar = Lidar::new(model, LidarSettings { moving, ..LidarSettings::default() }).unwrap();
    let settings = Settings { voxel_size: 0.1, max_range: 20.0, threads: 2, ..Settings::default() };
    let mut mapper = Mapper::new(settings).unwrap();
    let start = scene.trajectory.pose(3.0) * circle_pose(0.0).inverse();
    for k in 0..SCANS {
        let time = 0.17 * k as f64;
        let pose_at = |t: f64| start * circle_pose(time + t);
        let mut cloud: Cloud = lidar.scan(&scene.world, pose_at, &Stream::new(7, &[k as u64]));
        let t_map_lidar = pose_at(0.0);
        if with_motion {
            let samples = (0..=10).map(|k| (0.01 * k as f32, t_map_lidar.inv_mul(&pose_at(0.01 * f64::from(k)))));
            cloud.motion = Motion::through(samples);
        }
        mapper.handle(Event::Scan(Scan { node: k as u64, time, t_map_lidar, cloud })).unwrap();
    }
    let mut errors = Vec::new();
    for submap in mapper.into_atlas().submaps() {
        let mesh = voxelastic::surface::extract(submap.tsdf(), 0.1, &MeshOptions::default());
        errors.extend(mesh.positions.iter().map(|p| {
            let q = submap.t_map_submap() * nalgebra::Point3::from(p.map(f64::from));
            scene.world.distance(q.coords.into()).abs()
        }));
    }
    errors.sort_by(f64::total_cmp);
    errors
}

#[test]
fn motion_compensated_map_is_as_accurate_as_a_static_one() {
    let scene = Scene::named("room", 1).unwrap();
    let [still, compensated, raw] = [(false, false), (true, true), (true, false)].map(|(moving, with_motion)| errors(&scene, moving, with_motion));
    let mean = |e: &[f64]| e.iter().sum::<f64>() / e.len() as f64;
    let within = |e: &[f64]| e.partition_point(|d| *d < 0.05) as f64 / e.len() as f64;
    for (name, e) in [("static", &still), ("moving, compensated", &compensated), ("moving, raw", &raw)] {
        let (mm, share) = (1e3 * mean(e), 100.0 * within(e));
        eprintln!("{name}: {} vertices, mean {mm:.2} mm, median {:.2} mm, {share:.1} % within 5 cm", e.len(), 1e3 * e[e.len() / 2]);
    }
    assert!(mean(&compensated) < 1.2 * mean(&still) && compensated[compensated.len() / 2] < 1.2 * still[still.len() / 2]);
    assert!(compensated.len() as f64 > 0.9 * still.len() as f64, "the surface is as complete");
    assert!(mean(&raw) > 2.0 * mean(&still), "without compensation the map is blurred");
}
