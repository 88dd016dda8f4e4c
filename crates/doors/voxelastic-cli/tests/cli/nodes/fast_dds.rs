//! A robot on Fast DDS, the middleware of most robots with ROS 2, against the program. It is compiled here, where Fast DDS and its generator are installed.

use crate::nodes::robots::run_together;
use crate::voxelastic;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Stdio};
use voxelastic_testing::{Domain, Need, skip};

/// Compiles the robot in a folder; none where that cannot be.
fn robot(folder: &Path) -> Option<Command> {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/nodes/fast_dds");
    for name in ["ros.idl", "robot.cpp"] {
        std::fs::copy(sources.join(name), folder.join(name)).unwrap();
    }
    let run = |program: &str, arguments: &[&str]| {
        let done = Command::new(program).args(arguments).current_dir(folder).stdin(Stdio::null()).output().ok()?;
        assert!(done.status.success(), "{program}: {}", String::from_utf8_lossy(&done.stderr));
        Some(())
    };
    let arguments = ["-O1", "-std=c++17", "robot.cpp", "ros.cxx", "rosPubSubTypes.cxx", "-o", "robot", "-lfastrtps", "-lfastcdr", "-lpthread"];
    let is_compiled = run("fastddsgen", &["-replace", "ros.idl"]).and_then(|()| run("g++", &arguments));
    if is_compiled.is_none() {
        skip(Need::FastDds, "there is no fastddsgen or no g++ (on Debian: libfastrtps-dev fastddsgen default-jre-headless g++)");
    }
    is_compiled.map(|()| Command::new(folder.join("robot")))
}

#[test]
fn a_robot_on_fast_dds_is_mapped_and_gets_the_map() {
    let dir = tempfile::tempdir().unwrap();
    let Some(mut robot) = robot(dir.path()) else { return };
    let domain = Domain::free();
    let number = domain.number().to_string();
    let flags = "-q live --ros2 --local --field both --every scan --voxel-size 0.1 --max-range 25 --node mapper --threads 2 -o map.vox";
    let mut node = voxelastic(dir.path());
    node.args(flags.split_whitespace()).args(["--domain", &number]);
    robot.arg(&number).stdin(Stdio::null()).stdout(Stdio::piped());
    let (robot, node) = run_together(robot, node, true);
    assert!(robot.status.success() && node.status.success(), "{robot:?} {node:?}");
    let counts: Value = serde_json::from_slice(&robot.stdout).unwrap();
    println!("{counts}");
    let count = |key: &str| counts[key].as_u64().unwrap();
    assert_eq!((count("occupied_off"), count("free_outside")), (0, 0), "{counts}");
    assert!(count("free") > 1000 && count("vertices_off") * 200 < count("vertices"), "{counts}");
}
