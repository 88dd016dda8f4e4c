//! The drive that `write.py` writes, and what must come out of it.

use nalgebra::{Translation3, UnitQuaternion};
use std::path::Path;
use voxelastic::event::{Event, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic::mapper::ScanSource;
use voxelastic::{Cloud, Pose};
use voxelastic_io::bag::Recording;
use voxelastic_io::dataset::Keyframing;
use voxelastic_io::{Error, OpenOptions};

pub const SCANS: usize = 12;
pub const POINTS: usize = 320;

pub fn every_scan() -> OpenOptions {
    OpenOptions { keyframing: Some(Keyframing::All), ..OpenOptions::default() }
}

/// The scans and the errors of a recording.
pub fn play(path: &Path, options: &OpenOptions) -> (Vec<Scan>, Vec<Error>) {
    let recording = Recording::open(path, options).unwrap_or_else(|e| panic!("{e}"));
    let (mut scans, mut errors) = (Vec::new(), Vec::new());
    for event in recording.events() {
        match event {
            Ok(Event::Scan(scan)) => scans.push(scan),
            Ok(_) => {}
            Err(error) => errors.push(error),
        }
    }
    if let Some(last) = scans.last() {
        let mut again = recording.clouds();
        assert_eq!(again.cloud(last.node).unwrap().points, last.cloud.points, "read a second time");
        assert_eq!(again.cloud(scans[0].node).unwrap().points, scans[0].cloud.points, "and from the beginning");
    }
    (scans, errors)
}

/// Pose of the lidar at scan k.
pub fn t_map_lidar(k: usize, height: f64) -> Pose {
    let k = k as f64;
    Pose::from_parts(Translation3::new(0.5 * k, 0.0, height), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.01 * k))
}

/// What a layout has besides points.
pub struct Has {
    pub ring: bool,
    pub time: bool,
    pub rows: usize,
}

pub fn check_cloud(cloud: &Cloud, k: usize, has: &Has, name: &str) {
    assert_eq!((cloud.len(), cloud.height), (POINTS, has.rows), "{name}");
    for (i, p) in cloud.points.iter().enumerate() {
        let (i, k) = (i as f32, k as f32);
        assert_eq!(*p, [1.0 + i / 8.0 + k, -i / 16.0, 0.5 * i - k], "{name}, point {i}");
    }
    let intensity = cloud.intensity.as_ref().unwrap();
    assert_eq!((intensity[7], intensity[123]), (7.0, 23.0), "{name}");
    assert_eq!(cloud.ring.as_ref().map(|r| r[35]), has.ring.then_some(3), "{name}");
    let time = cloud.time.as_ref().map(|t| t[300]);
    assert!(time.is_some() == has.time && time.is_none_or(|t| (t - 0.03).abs() < 1e-6), "{name}: {time:?}");
}

/// Checks a whole drive whose lidar is `height` above the poses.
pub fn check(path: &Path, has: &Has, height: f64) {
    let name = path.display().to_string();
    let (scans, errors) = play(path, &every_scan());
    assert!(errors.is_empty(), "{name}: {errors:?}");
    assert_eq!(scans.len(), SCANS, "{name}");
    for (k, scan) in scans.iter().enumerate() {
        assert_eq!(scan.node, k as u64);
        assert!((scan.time - (100.0 + 0.1 * k as f64)).abs() < 1e-6, "{name}: {}", scan.time);
        let expected = t_map_lidar(k, height);
        assert!(scan.t_map_lidar.translation_distance(&expected) < 1e-9 && scan.t_map_lidar.rotation_distance(&expected) < 1e-7, "{name}, {k}");
        check_cloud(&scan.cloud, k, has, &name);
    }
}
