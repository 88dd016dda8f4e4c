//! A robot of somebody else's, on Cyclone DDS and on Zenoh, against the program: names, the mount, states, frames, corrections, rivals, silence.

use super::zenoh_router::free_port;
use crate::voxelastic;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use voxelastic_testing::{Domain, PATIENCE};

/// What robot and program speak over.
enum Network {
    Cyclone,
    Zenoh,
}

const INTERFACE: &str =
    "<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General></Domain></CycloneDDS>";

/// Runs a script of a robot in FOLDER beside the program until it ends; then what the robot has seen, what the program said, and its exit code. The robot ends the program, or `is_stopped` does.
fn with_robot(python: String, script: &str, folder: &Path, flags: &str, network: Network, is_stopped: bool) -> (Value, String, Option<i32>) {
    let domain = Domain::free();
    let nodes = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let mut node = voxelastic(folder);
    node.args(flags.split_whitespace()).stderr(Stdio::piped());
    let place = match network {
        Network::Cyclone => {
            node.args(["--domain", &domain.number().to_string()]).env("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp");
            domain.number().to_string()
        }
        Network::Zenoh => {
            let locator = format!("tcp/127.0.0.1:{}", free_port());
            node.env("ZENOH_CONFIG_OVERRIDE", format!("connect/endpoints=[\"{locator}\"]"));
            locator
        }
    };
    let mut robot = Command::new(python);
    robot.arg("-B").arg(nodes.join("tests/cli/nodes").join(script)).arg(place).arg(folder).stdin(Stdio::null());
    robot.env("PYTHONPATH", nodes.join("../voxelastic-live/tests/ros2")).env("CYCLONEDDS_URI", INTERFACE);
    let (robot, output) = run_together(robot, node, is_stopped);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(robot.status.success(), "the robot failed ({}), see what it said; the program: {said}", robot.status);
    let text = std::fs::read_to_string(folder.join("seen.json")).unwrap_or_default();
    (serde_json::from_str(&text).unwrap_or_else(|_| panic!("{text}: {said}")), said, output.status.code())
}

/// Runs a robot beside the program until it ends; then what both have said. The robot ends the program, or `is_stopped` does; one that fails has not ended it.
pub fn run_together(mut robot: Command, mut node: Command, is_stopped: bool) -> (Output, Output) {
    let (mut robot, node) = (robot.spawn().unwrap(), node.spawn().unwrap());
    let begin = Instant::now();
    let status = loop {
        if let Some(status) = robot.try_wait().unwrap() {
            break status;
        }
        if begin.elapsed() > PATIENCE {
            robot.kill().unwrap();
            panic!("the robot has not got what it waits for");
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    if is_stopped || !status.success() {
        let id = rustix::process::Pid::from_child(&node);
        rustix::process::kill_process(id, rustix::process::Signal::INT).unwrap();
    }
    (robot.wait_with_output().unwrap(), node.wait_with_output().unwrap())
}

/// The costmaps that a robot would steer by, against what its lidar sees and an independent inflation of the obstacles in them.
#[test]
fn costmaps_show_what_comes_into_a_robots_way() {
    let Some(python) = voxelastic_testing::python("cyclonedds, numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    let flags = "live --ros2 --local --field both --every scan --voxel-size 0.1 --max-range 20 --node mapper --threads 2 --no-imu -o map.vox \
        --costmap-size 5 --footprint-radius 0.25 --inflation-radius 0.7 --cost-scaling 3";
    let (seen, said, code) = with_robot(python, "costmaps.py", dir.path(), flags, Network::Cyclone, true);
    println!("{seen}");
    assert_eq!(code, Some(0), "{said}");
    assert_eq!((&seen["frame"], &seen["size"]), (&json!("map"), &json!([50, 50])), "{seen}");
    // The middle of the window is the robot's base, to the nearest cell.
    assert!(seen["off_centre_m"].as_f64().is_some_and(|off| off < 0.12), "{seen}");
    for key in ["wrong_costs", "false_obstacles", "unknown_under"] {
        assert_eq!(seen[key], 0, "{key}: {seen}");
    }
    // Ten times a second on a machine that has time; somebody who comes is there with the next scan, and gone once the scans have looked through there.
    let number = |key: &str| seen[key].as_f64().unwrap_or(f64::NAN);
    assert!(number("noticed_s") < 2.0 && number("gone_s") < 4.0, "{seen}");
    // Only what the floor itself takes costs more: at the edges of what was seen of it.
    assert!(number("too_high") < 0.1, "{seen}");
    // One with each scan that is mapped: ten times a second on a machine that has time, seldom beside compilers, where scans are left out.
    assert!(number("mapped") > 20.0 && number("count") > 0.8 * number("mapped"), "{seen} {said}");
    assert!(seen["gap_ms"][0].as_f64().is_some_and(|gap| gap < 1000.0), "{seen} {said}");
    assert_eq!(seen["same_obstacles"], true, "{seen}");
}

#[test]
fn a_robot_on_cyclone_dds_is_mapped_and_told_what_is_wrong() {
    is_mapped_and_told_what_is_wrong("--ros2 --local", Network::Cyclone);
}

#[test]
fn a_robot_on_zenoh_is_mapped_and_told_what_is_wrong() {
    is_mapped_and_told_what_is_wrong("--ros2=zenoh", Network::Zenoh);
}

fn is_mapped_and_told_what_is_wrong(network_flags: &str, network: Network) {
    let Some(python) = voxelastic_testing::python("cyclonedds, zenoh, rosbags, pyoctomap, numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    // As users of ROS 2 type it; transforms are found in the namespace.
    let flags = format!(
        "live {network_flags} --lifecycle --field both --every 0.3m --voxel-size 0.1 --max-range 20 --correction-topic corrected --costmap-size 10 --footprint-radius 0.2 -o map.vox \
        --ros-args -r __ns:=/robot1 -r __node:=mapper -r grid:=/map -p threads:=2 --log-level info"
    );
    // The robot shuts it down, by its states.
    let (seen, said, code) = with_robot(python, "robots.py", dir.path(), &flags, network, false);
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(seen["states"], json!([[1, "unconfigured"], true, true, false, [3, "active"], true]), "{seen}");
    // Without the mount nothing is mapped, and it is said why; nothing is mapped as if the lidar were the robot.
    let words = |key: &str| seen[key].as_str().unwrap_or_default().to_owned();
    assert!(words("without_mount").contains("no fixed transform leads from base_link to lidar"), "{seen}");
    assert_eq!((&seen["scans_without_mount"], &seen["grid_frame"]), (&json!("0"), &json!("map")), "{seen}");
    assert!(seen["first_lidar"][2].as_f64().is_some_and(|z| (z - 0.4).abs() < 1e-6), "{seen}");
    // A plan from where the robot is, in its own frame; none from a frame that is not there.
    let plan = &seen["plan"];
    assert!(plan["frame"] == "map" && plan["off_m"].as_f64().is_some_and(|off| off < 0.5), "{seen}");
    assert_eq!((&seen["plan_from_nonsense"], &seen["get_map"]), (&json!(0), &json!(["map", true, true])), "{seen}");
    assert!(said.contains("the frame nonsense is not connected with the map; the frames are: base_link, imu_link, lidar, map, odom"), "{said}");
    // Old walls go from all topics within 2 s on a machine that has time, as is promised, in some seconds beside other tests; what is large is read slowly by the robot itself.
    let old = &seen["old_walls"];
    assert!(old["before"]["grid"].as_u64() > Some(50), "{seen}");
    for (topic, most) in [("grid", 10.0), ("local_costmap", 10.0), ("octomap", 30.0), ("surface", 30.0)] {
        assert!(old["before"][topic].as_u64() > Some(0), "{topic}: {seen}");
        assert!(old["gone_s"][topic].as_f64().is_some_and(|seconds| seconds < most), "{topic}: {seen}");
    }
    println!(
        "old walls went so many seconds after the correction: {}; the first scan was mapped {} s after the mount came",
        old["gone_s"], seen["first_scan_s"]
    );
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
