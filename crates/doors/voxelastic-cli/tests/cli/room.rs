//! A room to map: a box with a pillar, scanned by a small spinning LiDAR on a path through it.

use nalgebra::{Translation3, UnitQuaternion};
use std::path::Path;
use voxelastic::{Cloud, Pose};
use voxelastic_io::{pcd, poses};

const ROWS: usize = 24;
const COLUMNS: usize = 240;

/// Corners of the room, metres, map frame.
pub const MIN: [f64; 3] = [-1.0, -3.0, 0.0];
pub const MAX: [f64; 3] = [9.0, 3.0, 2.6];

/// Pose of the `i`-th scan: along x, swaying a little.
pub fn pose(i: usize) -> Pose {
    let i = i as f64;
    Pose::from_parts(Translation3::new(0.25 * i, 0.4 * (0.5 * i).sin(), 1.2), UnitQuaternion::from_euler_angles(0.02, -0.01, 0.1 * i))
}

/// The organised scan taken at `t_map_lidar`, with intensity.
pub fn scan(t_map_lidar: &Pose) -> Cloud {
    let mut points = Vec::with_capacity(ROWS * COLUMNS);
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            let elevation = (35.0 - 70.0 * row as f64 / (ROWS - 1) as f64).to_radians();
            let azimuth = std::f64::consts::TAU * column as f64 / COLUMNS as f64;
            let direction = nalgebra::Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let range = cast(t_map_lidar.translation.vector.into(), (t_map_lidar.rotation * direction).into());
            points.push((direction * range).map(|c| c as f32).into());
        }
    }
    let intensity = Some((0..points.len()).map(|i| (i % 200) as f32).collect());
    Cloud { points, width: COLUMNS, height: ROWS, intensity, ..Cloud::default() }
}

/// Distance along a ray from inside of the room to its walls or the pillar (a box 4 to 4.5 m along x, 1.5 to 2 m along y).
fn cast(from: [f64; 3], direction: [f64; 3]) -> f64 {
    let walls = (0..3).map(|k| if direction[k] > 0.0 { (MAX[k] - from[k]) / direction[k] } else { (MIN[k] - from[k]) / direction[k] });
    let wall = walls.fold(f64::INFINITY, f64::min);
    let (low, high) = ([4.0, 1.5], [4.5, 2.0]);
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for k in 0..2 {
        let (a, b) = ((low[k] - from[k]) / direction[k], (high[k] - from[k]) / direction[k]);
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    if enter < leave { wall.min(enter) } else { wall }
}

/// Writes `count` scans into `dir/scans` and their poses to `dir/poses.tum`, 0.1 s apart.
pub fn write(dir: &Path, count: usize) {
    std::fs::create_dir_all(dir.join("scans")).unwrap();
    for i in 0..count {
        pcd::write(dir.join(format!("scans/{i:06}.pcd")), &scan(&pose(i))).unwrap();
    }
    write_poses(dir, count);
}

/// Writes `count` poses to `dir/poses.tum`.
pub fn write_poses(dir: &Path, count: usize) {
    let poses: Vec<(f64, Pose)> = (0..count).map(|i| (0.1 * i as f64, pose(i))).collect();
    poses::write_tum(dir.join("poses.tum"), &poses).unwrap();
}
