//! Recordings as their users map them.

use crate::{json, voxelastic, works};
use std::path::{Path, PathBuf};

/// A recording that other software wrote (see `voxelastic-io/tests/all/bags/write.py`).
fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../parts/voxelastic-io/tests/all/bags/fixtures").join(name)
}

#[test]
fn info_lists_topics_and_the_choice_among_them() {
    let dir = tempfile::tempdir().unwrap();
    let bag = fixture("ouster_bz2.bag");
    let info = json(dir.path(), &format!("info {} --json", bag.display()));
    assert_eq!((info["kind"].as_str(), info["format"].as_str()), (Some("recording"), Some("ROS 1 bag")));
    assert_eq!((info["cloud_topic"].as_str(), info["poses"].as_str()), (Some("/points"), Some("/odometry")));
    assert_eq!(info["topics"][1]["messages"].as_u64(), Some(12));
    let text = works(dir.path(), &format!("info {}", bag.display()));
    assert!(text.contains("sensor_msgs/PointCloud2") && text.contains("clouds to map"), "{text}");
}

/// Puts the first scans of a KITTI street, driven a number of times, into a bag and into a folder, with the same poses in both.
const SPLIT: &str = r#"
import sys, shutil, numpy as np
from pathlib import Path
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
street, out, count, rounds = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
store = get_typestore(Stores.ROS1_NOETIC)
t = lambda name: store.types[name]
(out / "folder" / "velodyne").mkdir(parents=True)
rows = np.loadtxt(street / "poses_odometry.txt").reshape(-1, 3, 4)[:count]
scans = sorted((street / "velodyne").glob("*.bin"))[:count]
def quaternion(m):
    w = np.sqrt(max(1e-12, 1 + m[0, 0] + m[1, 1] + m[2, 2])) / 2
    q = np.array([(m[2, 1] - m[1, 2]) / (4 * w), (m[0, 2] - m[2, 0]) / (4 * w), (m[1, 0] - m[0, 1]) / (4 * w), w])
    return q / np.linalg.norm(q)
field = t("sensor_msgs/msg/PointField")
fields = [field(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate(("x", "y", "z", "intensity"))]
with Writer(out / "street.bag") as bag, open(out / "folder" / "poses.tum", "w") as tum:
    clouds = bag.add_connection("/velodyne_points", "sensor_msgs/msg/PointCloud2", typestore=store)
    poses = bag.add_connection("/odometry", "geometry_msgs/msg/PoseStamped", typestore=store)
    for k, (scan, row) in enumerate(list(zip(scans, rows)) * rounds):
        shutil.copy(scan, out / "folder" / "velodyne")
        q, p = quaternion(row[:, :3]), row[:, 3]
        tum.write(f"{100 + k}.0 " + " ".join(repr(float(v)) for v in (*p, *q)) + "\n")
        header = lambda frame: t("std_msgs/msg/Header")(seq=k, stamp=t("builtin_interfaces/msg/Time")(100 + k, 0), frame_id=frame)
        point = t("geometry_msgs/msg/Point")(*map(float, p))
        pose = t("geometry_msgs/msg/Pose")(position=point, orientation=t("geometry_msgs/msg/Quaternion")(*map(float, q)))
        raw = np.fromfile(scan, np.uint8)
        n = raw.size // 16
        cloud = t("sensor_msgs/msg/PointCloud2")(header=header("velodyne"), height=1, width=n, fields=fields, is_bigendian=False,
                                                 point_step=16, row_step=16 * n, data=raw, is_dense=True)
        now = (100 + k) * 10**9
        bag.write(clouds, now, store.serialize_ros1(cloud, cloud.__msgtype__))
        stamped = t("geometry_msgs/msg/PoseStamped")(header=header("map"), pose=pose)
        bag.write(poses, now + 10**8, store.serialize_ros1(stamped, stamped.__msgtype__))
"#;

/// All files of a map with their content, but for the lock and the log of the run, which are no part of the map.
fn content(map: &Path) -> Vec<(String, Vec<u8>)> {
    let files = std::fs::read_dir(map).unwrap().map(Result::unwrap);
    let mut files: Vec<_> = files.map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap())).collect();
    files.retain(|(name, _)| name != ".lock" && name != "run.json");
    files.sort();
    files
}

/// Writes `street.bag` and `folder` with `rounds` rounds of the street, and returns the number of scans; none, after noting the skip, without data or
/// library.
fn street(rounds: usize) -> Option<(tempfile::TempDir, String)> {
    let street = voxelastic_testing::data("kitti00-street")?;
    let dir = tempfile::tempdir().unwrap();
    let scans = std::env::var("VOXELASTIC_STREET_SCANS").unwrap_or_else(|_| "6".into());
    let rounds = rounds.to_string();
    voxelastic_testing::run_python("rosbags, numpy", SPLIT, &[&street, dir.path(), Path::new(&scans), Path::new(&rounds)])?;
    Some((dir, scans))
}

#[test]
fn memory_does_not_grow_with_the_bag() {
    let figures = |rounds: usize| {
        let (dir, scans) = street(rounds)?;
        // All rounds go into one submap, so that the map is as large.
        let one_submap = "--voxel-size 0.2 --max-range 30 --lambda-odom 100000 --min-overlap 1";
        let report = json(dir.path(), &format!("map street.bag --every scan {one_submap} --json"));
        assert_eq!((report["scans"].as_u64(), report["submaps"].as_u64()), (Some(scans.parse::<u64>().unwrap() * rounds as u64), Some(1)));
        let bag = std::fs::metadata(dir.path().join("street.bag")).unwrap().len() as f64 / 1e6;
        Some([bag, report["peak_rss_mb"].as_f64()?, report["map_mb"].as_f64()?])
    };
    // A few rounds, because the allocator keeps some megabytes more after the first scans, sooner or later.
    let (Some(once), Some(often)) = (figures(4), figures(20)) else { return };
    for [bag, peak, map] in [once, often] {
        eprintln!("bag of {bag:.0} MB: peak {peak:.0} MB, of them {map:.0} MB of map");
    }
    let (longer, more) = (often[0] - once[0], (often[1] - often[2]) - (once[1] - once[2]));
    assert!(more < 0.1 * longer, "{longer:.0} MB more of bag take {more:.0} MB more of memory");
}

#[test]
fn a_bag_and_a_folder_of_the_same_scans_give_the_same_map() {
    let Some((dir, scans)) = street(1) else { return };
    let quick = "--voxel-size 0.2 --max-range 30 --json";
    let folder = json(dir.path(), &format!("map folder -o folder.vox {quick}"));
    let bag = json(dir.path(), &format!("map street.bag -o bag.vox --every scan {quick}"));
    assert_eq!((&folder["scans"], bag["scans"].to_string()), (&bag["scans"], scans));
    let (of_folder, of_bag) = (content(&dir.path().join("folder.vox")), content(&dir.path().join("bag.vox")));
    let names = |files: &[(String, Vec<u8>)]| files.iter().map(|(n, b)| (n.clone(), b.len())).collect::<Vec<_>>();
    assert_eq!(names(&of_folder), names(&of_bag));
    for ((name, a), (_, b)) in of_folder.iter().zip(&of_bag) {
        assert!(a == b, "{name} differs");
    }
    // Held-out scans and the first few are taken while the bag plays.
    let held = json(dir.path(), &format!("map street.bag -o held.vox --every scan --hold-out 3 --max-scans 5 {quick}"));
    assert_eq!((held["scans"].as_u64(), held["scans_held_out"].as_u64()), (Some(4), Some(1)));
    let output = voxelastic(dir.path()).args(["map", "folder", "--cloud-topic", "/x"]).output().unwrap();
    assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains("no topics"));
}
