//! A robot of somebody else's, on Cyclone DDS, against the program: names, the mount, states, frames, corrections, rivals, silence.

use crate::voxelastic;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use voxelastic_testing::{Domain, PATIENCE};

const INTERFACE: &str =
    "<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General></Domain></CycloneDDS>";

#[test]
fn a_robot_on_cyclone_dds_is_mapped_and_told_what_is_wrong() {
    let Some(python) = voxelastic_testing::python("cyclonedds, numpy") else { return };
    let (dir, domain) = (tempfile::tempdir().unwrap(), Domain::free());
    let number = domain.number().to_string();
    let nodes = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let mut robot = Command::new(python);
    robot.arg("-B").arg(nodes.join("tests/cli/nodes/robots.py")).args([number.as_str()]).arg(dir.path()).stdin(Stdio::null());
    robot.env("PYTHONPATH", nodes.join("../voxelastic-live/tests/ros2")).env("CYCLONEDDS_URI", INTERFACE);
    let mut robot = robot.spawn().unwrap();
    // As users of ROS 2 type it; transforms are found in the namespace.
    let flags = "live --ros2 --local --lifecycle --field both --every 0.3m --voxel-size 0.1 --max-range 20 --correction-topic corrected -o map.vox \
        --ros-args -r __ns:=/robot1 -r __node:=mapper -r grid:=/map -p threads:=2 --log-level info";
    let mut node = voxelastic(dir.path());
    node.args(flags.split_whitespace()).args(["--domain", &number]).env("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp").stderr(Stdio::piped());
    let node = node.spawn().unwrap();
    let begin = Instant::now();
    while robot.try_wait().unwrap().is_none() {
        assert!(begin.elapsed() < PATIENCE, "the robot has not got what it waits for");
        std::thread::sleep(Duration::from_millis(50));
    }
    // The robot has shut it down, by its states.
    let output = node.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    let text = std::fs::read_to_string(dir.path().join("seen.json")).unwrap_or_default();
    let seen: serde_json::Value = serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text}: {said}"));
    assert_eq!(seen["states"], serde_json::json!([[1, "unconfigured"], true, true, false, [3, "active"], true]), "{seen}");
    // Without the mount nothing is mapped, and it is said why; nothing is mapped as if the lidar were the robot.
    let words = |key: &str| seen[key].as_str().unwrap_or_default().to_owned();
    assert!(words("without_mount").contains("no fixed transform leads from base_link to lidar"), "{seen}");
    assert_eq!((&seen["scans_without_mount"], &seen["grid_frame"]), (&serde_json::json!("0"), &serde_json::json!("map")), "{seen}");
    assert!(seen["first_lidar"][2].as_f64().is_some_and(|z| (z - 0.4).abs() < 1e-6), "{seen}");
    // A plan from where the robot is, in its own frame; none from a frame that is not there.
    let plan = &seen["plan"];
    assert!(plan["frame"] == "map" && plan["off_m"].as_f64().is_some_and(|off| off < 0.5), "{seen}");
    assert_eq!((&seen["plan_from_nonsense"], &seen["get_map"]), (&serde_json::json!(0), &serde_json::json!(["map", true, true])), "{seen}");
    assert!(said.contains("the frame nonsense is not connected with the map; the frames are: base_link, imu_link, lidar, map, odom"), "{said}");
    // Old walls go within a second on a machine that has time (2 s is what is promised), in some seconds beside other tests.
    let old = &seen["old_walls"];
    assert!(old["before"].as_u64() > Some(50) && old["after"] == 0, "{seen}");
    assert!(old["seconds"].as_f64().is_some_and(|seconds| seconds < 10.0), "{seen}");
    println!("old walls went {} s after the correction; the first scan was mapped {} s after the mount came", old["seconds"], seen["first_scan_s"]);
    assert!(words("rival").contains("somebody else publishes the transform map -> odom"), "{seen}");
    // The grid that is kept up from its changes is the whole one; all of it comes seldom.
    let messages = |k: usize| seen["grid_messages"][k].as_u64().unwrap();
    assert!(messages(1) > messages(0) && messages(2) <= 2, "{seen}");
    println!("grids, updates of it: {}", seen["grid_messages"]);
    // A pose is of use where scans are looked for, and refused in words elsewhere.
    assert!(said.contains("initial pose: the scans are not looked for: they are in the map already"), "{said}");
    assert!(said.contains("initial pose: the frame nonsense is not connected with the map"), "{said}");
    assert!(said.contains("scans are looked for within 2.0 m of (") && said.contains("found in the map"), "{said}");
    let loaded = &seen["loaded"];
    assert_eq!(loaded.as_array().map(|all| &all[..3]), Some(&[true.into(), 0.into(), true.into()][..]), "{seen}");
    // The robot drives in circles of 1.5 m around the origin of the map, whatever its odometry says.
    assert!(loaded[3].as_f64().is_some_and(|off| off < 0.2), "{seen}");
    assert!(words("silence").contains("nothing came on /robot1/points for") && seen["silence_level"] == 1, "{seen}");
}
