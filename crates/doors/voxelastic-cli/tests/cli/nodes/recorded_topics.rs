//! A node whose robot is restarted while it maps topics, and the recording that it makes of them, mapped afterwards.

use crate::first_map::content;
use crate::{room, voxelastic, works};
use rustix::process::{Pid, Signal, kill_process};
use std::net::TcpListener;
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};
use voxelastic::Pose;
use voxelastic_live::ros::dds::Dds;
use voxelastic_live::ros::messages::{Header, point_cloud};
use voxelastic_live::ros::middleware::{Delivery, Middleware, NodeOptions, Sink, TopicProfile};
use voxelastic_testing::{Domain, PATIENCE};

const FLAGS: &str = "--voxel-size 0.2 --max-range 12 --every scan";

/// `nav_msgs/Odometry` in CDR: numbers are aligned to their size, from the end of a header of four bytes.
fn odometry(stamp: f64, pose: &Pose) -> Vec<u8> {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    let mut message: Vec<u8> = [stamp as u32, (stamp.fract() * 1e9).round() as u32].iter().flat_map(|n| n.to_le_bytes()).collect();
    for frame in ["odom", "lidar"] {
        message.resize(message.len().next_multiple_of(4), 0);
        message.extend((frame.len() as u32 + 1).to_le_bytes());
        message.extend(frame.bytes().chain([0]));
    }
    message.resize(message.len().next_multiple_of(8), 0);
    // Without covariances and velocities.
    let numbers = [t.x, t.y, t.z, q.x, q.y, q.z, q.w].into_iter().chain([0.0; 36 + 6 + 36]);
    [0, 1, 0, 0].into_iter().chain(message).chain(numbers.flat_map(f64::to_le_bytes)).collect()
}

/// A robot that publishes clouds and poses.
struct Robot {
    points: Box<dyn Sink>,
    odom: Box<dyn Sink>,
    _dds: Dds,
}

impl Robot {
    fn start(domain: u16) -> Self {
        let mut dds = Dds::open(&NodeOptions { name: "robot".to_owned(), domain, local_only: true, ..NodeOptions::default() }).unwrap();
        let mut topic = |name: &str, kind: &str| {
            let profile = TopicProfile { name: name.to_owned(), kind: kind.to_owned(), delivery: Delivery::Reliable, depth: 16 };
            dds.advertise(&profile).unwrap()
        };
        let (points, odom) = (topic("/points", "sensor_msgs/msg/PointCloud2"), topic("/odom", "nav_msgs/msg/Odometry"));
        Self { points, odom, _dds: dds }
    }

    /// Drives on from scan `first`, with a clock that said `from` seconds then, until `is_enough`.
    fn drive(&mut self, first: usize, from: f64, is_enough: impl Fn() -> bool) -> usize {
        let begin = Instant::now();
        for k in 0.. {
            assert!(begin.elapsed() < PATIENCE, "{k} scans were sent, and not enough came");
            let (stamp, pose) = (from + 0.1 * k as f64, room::pose((first + k) % 24));
            self.odom.publish(&odometry(stamp, &pose)).unwrap();
            let points = room::scan(&pose).points;
            self.points.publish(&point_cloud(Header { stamp, frame: "lidar" }, &points, &[])).unwrap();
            std::thread::sleep(Duration::from_millis(80));
            if is_enough() {
                return first + k + 1;
            }
        }
        first
    }
}

/// What the node says about itself; null where it does not answer.
pub fn health(page: u16) -> serde_json::Value {
    use std::io::{Read, Write};
    let Ok(mut stream) = std::net::TcpStream::connect(("127.0.0.1", page)) else { return serde_json::Value::Null };
    let mut answer = String::new();
    let _ = write!(stream, "GET /health HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n").and_then(|()| stream.read_to_string(&mut answer));
    let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
    serde_json::from_str(body).unwrap_or_default()
}

/// Scans that the node has mapped.
pub fn mapped(page: u16) -> u64 {
    health(page)["scans"].as_u64().unwrap_or(0)
}

pub fn ended(mut node: Child) {
    kill_process(Pid::from_child(&node), Signal::TERM).unwrap();
    assert_eq!(node.wait().unwrap().code(), Some(0));
}

/// Maps a robot that is restarted after some scans, with a clock that says `then` seconds; the recording of it must give the same map. Not where a busy machine left
/// scans out, which the recording has: then it is done again.
fn same_after_a_restart(then: f64) {
    let domain = Domain::free();
    let is_done = (0..4).any(|_| {
        let dir = tempfile::tempdir().unwrap();
        is_same_after_a_restart(dir.path(), domain.number(), then)
    });
    assert!(is_done, "scans were left out each time");
}

/// Whether no scan was left out.
fn is_same_after_a_restart(dir: &Path, domain: u16, then: f64) -> bool {
    let page = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let network = format!("--ros2=dds --domain {domain} --local --record drive.mcap --view=127.0.0.1:{page}");
    let node = voxelastic(dir).args(format!("-q live {network} {FLAGS} -o live.vox").split_whitespace()).spawn().unwrap();
    let mut robot = Robot::start(domain);
    let next = robot.drive(0, 1000.0, || mapped(page) >= 8);
    drop(robot);
    std::thread::sleep(Duration::from_millis(500));
    let before = mapped(page);
    Robot::start(domain).drive(next, then, || mapped(page) >= before + 8);
    std::thread::sleep(Duration::from_millis(500));
    let left_out = health(page)["scans_left_out"].as_u64().unwrap();
    ended(node);
    if left_out > 0 {
        return false;
    }
    let recorded: serde_json::Value = serde_json::from_str(&works(dir, &format!("map drive.mcap {FLAGS} --json -o map.vox"))).unwrap();
    assert!(recorded["scans"].as_u64().unwrap() >= before + 8, "{recorded}");
    let [live, again] = ["live.vox", "map.vox"].map(|map| content(&dir.join(map)));
    assert!(live.iter().any(|(name, _)| name.ends_with(".vxs")));
    assert!(live == again, "the recording of what came gives another map");
    true
}

#[test]
fn a_recording_of_topics_gives_the_map_that_was_made_of_them() {
    same_after_a_restart(1100.0);
}

#[test]
fn so_it_does_where_the_robots_clock_went_back() {
    same_after_a_restart(900.0);
}
