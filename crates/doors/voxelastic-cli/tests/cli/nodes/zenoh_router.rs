//! A node on a Zenoh network whose router, somebody else's program, comes late and is started again.

use crate::nodes::recorded_topics::{ended, health, mapped};
use crate::voxelastic;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use voxelastic_testing::PATIENCE;

/// A program that is killed with the test.
struct Peer(Child);

impl Peer {
    fn start(python: &str, mode: &str, locator: &str, folder: &Path) -> Self {
        let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../voxelastic-live/tests/ros2/zenoh_peer.py");
        Self(Command::new(python).arg("-B").arg(script).args([mode, locator]).arg(folder).stdin(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn wait(what: &str, is_true: impl Fn() -> bool) {
    let begin = Instant::now();
    while !is_true() {
        assert!(begin.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_router_may_come_late_and_be_started_again() {
    let Some(python) = voxelastic_testing::python("zenoh, rosbags, numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    let points: Vec<u8> = (0..6000).flat_map(|k| [5.0, (k % 80) as f32 * 0.1 - 4.0, (k / 80) as f32 * 0.05]).flat_map(f32::to_le_bytes).collect();
    std::fs::write(dir.path().join("scan-0.f32"), points).unwrap();
    let (page, locator) = (free_port(), format!("tcp/127.0.0.1:{}", free_port()));
    let flags = format!("-q live --ros2=zenoh --view=127.0.0.1:{page} --voxel-size 0.2 --max-range 12 --every scan -o live.vox");
    let mut node = voxelastic(dir.path());
    let node = node.args(flags.split(' ')).env("ZENOH_CONFIG_OVERRIDE", format!("connect/endpoints=[\"{locator}\"]")).spawn().unwrap();
    wait("the node does not say that it is there while it waits for topics", || health(page)["state"] == "starting");
    let start = |mode| Peer::start(&python, mode, &locator, dir.path());
    let mut before = 0;
    for turn in 0..2 {
        // Both of them end as in a power failure.
        let (_router, _robot) = (start("route"), start("give"));
        wait(&format!("turn {turn}: no scan comes after scan {before}"), || mapped(page) >= before + 5);
        before = mapped(page);
        assert_eq!(health(page)["state"], "mapping");
    }
    ended(node);
}
