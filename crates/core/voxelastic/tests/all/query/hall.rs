//! The `hall` recording of the development data, mapped: a real map for benches and tests.

use std::path::PathBuf;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::settings::FieldKind;
use voxelastic::{Cloud, Mapper, Pose, Settings};

/// The recording's folder, if the data is there.
pub fn folder() -> Option<PathBuf> {
    voxelastic_testing::data("hall")
}

/// Every `step`-th scan of the hall with its pose. The scans are binary PCD files of x, y, z.
pub fn scans(step: usize) -> Option<Vec<Scan>> {
    let hall = folder()?;
    let poses = std::fs::read_to_string(hall.join("poses.tum")).ok()?;
    let rows = poses.lines().filter(|l| !l.starts_with('#')).enumerate().step_by(step);
    rows.map(|(i, row)| {
        let n: Vec<f64> = row.split_whitespace().filter_map(|n| n.parse().ok()).collect();
        let &[time, x, y, z, qx, qy, qz, qw] = n.as_slice() else { return None };
        let rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(qw, qx, qy, qz));
        let bytes = std::fs::read(hall.join(format!("scans/{i:06}.pcd"))).ok()?;
        let marker = b"DATA binary\n";
        let start = bytes.windows(marker.len()).position(|w| w == marker)? + marker.len();
        let points = bytes[start..]
            .as_chunks::<12>()
            .0
            .iter()
            .map(|p| std::array::from_fn(|k| f32::from_le_bytes([p[4 * k], p[4 * k + 1], p[4 * k + 2], p[4 * k + 3]])));
        let cloud = Cloud::from_points(points.collect());
        Some(Scan { node: i as u64, time, t_map_lidar: Pose::from_parts([x, y, z].into(), rotation), cloud })
    })
    .collect()
}

/// The occupancy of the hall, from every `step`-th scan.
pub fn map(settings: Settings, step: usize) -> Option<Atlas> {
    map_with(Settings { field: FieldKind::Occupancy, ..settings }, step)
}

/// The hall mapped with `settings`, from every `step`-th scan.
pub fn map_with(settings: Settings, step: usize) -> Option<Atlas> {
    let mut mapper = Mapper::new(settings).ok()?;
    for scan in scans(step)? {
        mapper.handle(Event::Scan(scan)).ok()?;
    }
    Some(mapper.into_atlas())
}
