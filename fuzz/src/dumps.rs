//! Folders of SLAM systems and data sets that are sound but for one file.

use crate::folder;
use std::path::PathBuf;
use voxelastic::Cloud;
use voxelastic_io::pcd;

/// Name of a folder, the file that is tried, and files beside it.
type Layout = (&'static str, &'static str, &'static [(&'static str, Content)]);

/// What a file beside holds.
#[derive(Clone, Copy)]
enum Content {
    Pcd,
    Bin,
    Text(&'static str),
}

use Content::{Bin, Pcd, Text};

const POSES: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n";
const DATA: &str = "stamp 1 5\nestimate\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\nid 0\n";

/// Seeds begin with the letter of their layout, `a` for the first. Where the file itself is a trajectory, its path is what is opened.
const LAYOUTS: [Layout; 11] = [
    ("hdl", "000000/data", &[("000000/cloud.pcd", Pcd), ("000001/cloud.pcd", Pcd), ("000001/data", Text(DATA))]),
    ("hdl-graph", "graph.g2o", &[("000000/cloud.pcd", Pcd), ("000000/data", Text(DATA))]),
    ("glim", "000000/data.txt", &[("000000/points_compact.bin", Bin)]),
    ("hba", "pose.json", &[("pcd/0.pcd", Pcd), ("pcd/1.pcd", Pcd)]),
    ("kitti", "calib.txt", &[("poses.txt", Text(POSES)), ("velodyne/000000.bin", Bin), ("velodyne/000001.bin", Bin)]),
    ("mulran", "global_pose.csv", &[("Ouster/1000000000.bin", Bin), ("Ouster/1100000000.bin", Bin)]),
    ("lio-sam", "transformations.pcd", &[]),
    ("folder", "poses.txt", &[("scans/000000.pcd", Pcd), ("scans/000001.pcd", Pcd)]),
    ("times", "times.txt", &[("scans/000000.pcd", Pcd), ("scans/000001.pcd", Pcd), ("poses.txt", Text(POSES))]),
    ("snapshot", "poses@000000.txt", &[("scans/000000.pcd", Pcd), ("scans/000001.pcd", Pcd), ("poses.txt", Text(POSES))]),
    ("newer-college", "ground_truth/registered_poses.csv", &[("raw_format/ouster_scan/cloud_1583836591_500000000.pcd", Pcd)]),
];

/// Puts `data` into the folder of a layout; what is to be opened.
pub fn put(layout: usize, data: &[u8]) -> PathBuf {
    let (name, tried, beside) = LAYOUTS[layout % LAYOUTS.len()];
    let folder = folder().join(name);
    if !folder.is_dir() {
        beside.iter().for_each(|(file, content)| write(&folder.join(file), *content));
        std::fs::create_dir_all(folder.join(tried).parent().unwrap_or(&folder)).expect("a folder to write to");
    }
    std::fs::write(folder.join(tried), data).expect("space to write to");
    if beside.is_empty() { folder.join(tried) } else { folder }
}

fn write(path: &std::path::Path, content: Content) {
    std::fs::create_dir_all(path.parent().unwrap_or(path)).expect("a folder to write to");
    let points: Vec<[f32; 3]> = (0..3).map(|k| [1.0 + k as f32, 2.0, 3.0]).collect();
    match content {
        Pcd => pcd::write(path, &Cloud::from_points(points)).expect("a cloud is written"),
        // Twelve numbers are three points of four numbers and four of three.
        Bin => std::fs::write(path, [1f32; 12].map(f32::to_le_bytes).concat()).expect("space to write to"),
        Text(text) => std::fs::write(path, text).expect("space to write to"),
    }
}
