//! Maps that tests edit: a street that is broken on purpose and a room; what is in their files.

use crate::{room, works};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::MapStore;
use voxelastic_io::{PoseGraph, g2o, pcd, ply, poses};

/// All files of a map, also its lock and the log of its run.
pub fn files(map: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(map).unwrap().map(|entry| entry.unwrap());
    entries.map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap())).collect()
}

/// Fails with the names of the files that differ.
pub fn assert_same(map: &Path, expected: &BTreeMap<String, Vec<u8>>, when: &str) {
    let found = files(map);
    let names = found.keys().chain(expected.keys()).filter(|name| found.get(*name) != expected.get(*name));
    assert_eq!(names.collect::<Vec<_>>(), Vec::<&String>::new(), "{when}");
}

/// Poses of the scans of a map.
pub fn corrected(map: &Path) -> BTreeMap<NodeId, Pose> {
    let store = MapStore::open(map).unwrap();
    let mut all = BTreeMap::new();
    for entry in &store.manifest().submaps {
        let scans = if entry.corrected.is_empty() { &entry.scans } else { &entry.corrected };
        all.extend(scans.iter().map(|scan| (scan.node, entry.t_map_submap * scan.t_submap_lidar)));
    }
    all
}

/// How far a scan of a map is from the truth, at most, metres.
pub fn largest_error(map: &Path, truth: &[Pose]) -> f64 {
    corrected(map).iter().map(|(node, pose)| pose.translation_distance(&truth[*node as usize])).fold(0.0, f64::max)
}

/// A loop edge that is wrong by so many metres.
fn edge(poses: &[Pose], from: usize, to: usize, wrong_by: [f64; 3]) -> Edge {
    let off = Pose::translation(wrong_by[0], wrong_by[1], wrong_by[2]);
    Edge { from: from as NodeId, to: to as NodeId, t_from_to: poses[from].inv_mul(&(off * poses[to])), information: None }
}

/// A street, once round and a bit, whose odometry climbs by `climb` metres a scan and has a loop edge that is wrong by 2.8 m and none that is right, with ghosts in the air.
/// Returns where the ghosts are, and the true poses.
pub fn broken_street(dir: &Path, climb: f64) -> ([f64; 3], Vec<Pose>) {
    works(dir, "simulate street -o street --laps 1.15 --spacing 1.5 --columns 512");
    let street = dir.join("street");
    let truth = poses::read(street.join("groundtruth.tum")).unwrap().poses;
    for entry in fs::read_dir(&street).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.to_string_lossy().contains("poses@") {
            fs::remove_file(entry).unwrap();
        }
    }
    let odometry: Vec<Pose> = truth.iter().enumerate().map(|(k, pose)| Pose::translation(0.0, 0.0, climb * k as f64) * pose).collect();
    let stamped: Vec<(f64, Pose)> = odometry.iter().enumerate().map(|(k, pose)| (0.1 * k as f64, *pose)).collect();
    poses::write_tum(street.join("poses.tum"), &stamped).unwrap();
    let nodes = odometry.iter().enumerate().map(|(k, pose)| (k as NodeId, *pose)).collect();
    let edges = vec![edge(&odometry, 40, 150, [2.0, 2.0, 0.0])];
    g2o::write(street.join("graph.g2o"), &PoseGraph { nodes, edges, fixed: vec![0] }).unwrap();
    // A ball of points over the road beside the tenth scan, as four scans saw it.
    let ghost = truth[10] * nalgebra::Point3::new(0.0, 3.0, 0.3);
    for (scan, t_map_lidar) in truth.iter().enumerate().take(13).skip(9) {
        let path = street.join(format!("scans/{scan:06}.pcd"));
        let mut cloud = pcd::read(&path).unwrap().cloud;
        let t_lidar_map = t_map_lidar.inverse();
        for point in &mut cloud.points {
            // On a sphere of 0.5 m, on the rays that meet it.
            let centre = (t_lidar_map * ghost).coords;
            let direction = nalgebra::Vector3::from(point.map(f64::from)).normalize();
            let along = direction.dot(&centre);
            let from_ray = (centre - along * direction).norm();
            if along > 0.0 && from_ray < 0.5 {
                *point = (direction * (along - (0.25 - from_ray * from_ray).sqrt())).map(|c| c as f32).into();
            }
        }
        pcd::write(&path, &cloud).unwrap();
    }
    (ghost.coords.into(), truth)
}

/// Vertices of the mesh of a map within a distance of a place.
pub fn vertices_near(dir: &Path, map: &str, place: [f64; 3], radius: f64) -> usize {
    works(dir, &format!("mesh {map} -o near.ply --keep-all"));
    let distance = |p: &[f32; 3]| (0..3).map(|k| (f64::from(p[k]) - place[k]).powi(2)).sum::<f64>().sqrt();
    ply::read_mesh(dir.join("near.ply")).unwrap().positions.iter().filter(|p| distance(p) < radius).count()
}

/// Maps a broken street.
pub fn map_street(dir: &Path, name: &str) {
    works(dir, &format!("map street -o {name} --optimize --field both --voxel-size 0.2 --max-range 30 --lambda-odom 15 --lambda-cluster 0"));
}

/// The submap of a scan.
pub fn submap_of(map: &Path, node: usize) -> u32 {
    let store = MapStore::open(map).unwrap();
    store.manifest().submaps.iter().find(|s| s.scans.iter().any(|scan| scan.node == node as NodeId)).unwrap().id
}

/// The submaps of the first scans of a broken street and of those at the same place a lap later.
pub fn submaps_of_a_lap(map: &Path, truth: &[Pose]) -> [u32; 2] {
    let from_first = |k: &usize| truth[*k].translation_distance(&truth[4]);
    let lap = (200..truth.len()).min_by(|a, b| from_first(a).total_cmp(&from_first(b))).unwrap();
    let both = [4, lap].map(|node| submap_of(map, node));
    assert_ne!(both[0], both[1]);
    both
}

/// A room in both fields in several submaps, with times and log.
pub fn small_map(dir: &Path, name: &str) {
    room::write(&dir.join("room"), 24);
    works(dir, &format!("map room -o {name} --voxel-size 0.1 --max-range 20 --field both --lambda-odom 1.5"));
}
