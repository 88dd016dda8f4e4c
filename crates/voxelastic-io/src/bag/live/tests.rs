//! Messages as a middleware delivers them.

use super::*;
use crate::OpenOptions;
use crate::scan_list::Keyframing;
use std::sync::mpsc::{SyncSender, sync_channel};
use voxelastic::event::Event;

/// A little-endian CDR message; numbers are aligned to their size.
struct Cdr(Vec<u8>);

impl Cdr {
    fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn pad(&mut self, size: usize) {
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    fn u8(mut self, value: u8) -> Self {
        self.0.push(value);
        self
    }

    fn u32(mut self, value: u32) -> Self {
        self.pad(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn f64s(mut self, values: &[f64]) -> Self {
        self.pad(8);
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    fn text(self, text: &str) -> Self {
        let mut message = self.u32(text.len() as u32 + 1);
        message.0.extend(text.bytes().chain([0]));
        message
    }

    fn header(self, time: f64, frame: &str) -> Self {
        self.u32(time as u32).u32((time.fract() * 1e9).round() as u32).text(frame)
    }

    fn pose(self, x: f64) -> Self {
        self.f64s(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    }
}

fn cloud(time: f64) -> Vec<u8> {
    let fields = ["x", "y", "z"];
    let mut message = Cdr::new().header(time, "lidar").u32(1).u32(2).u32(3);
    for (k, name) in fields.iter().enumerate() {
        message = message.text(name).u32(4 * k as u32).u8(7).u32(1);
    }
    message = message.u8(0).u32(12).u32(24).u32(24);
    [5.0f32, 0.0, 1.0, 0.0, 6.0, 1.0].iter().for_each(|v| message.0.extend(v.to_le_bytes()));
    message.u8(1).0
}

fn odometry(time: f64, x: f64) -> Vec<u8> {
    Cdr::new().header(time, "odom").text("base").pose(x).0
}

fn path(poses: &[(f64, f64)]) -> Vec<u8> {
    let message = Cdr::new().header(0.0, "map").u32(poses.len() as u32);
    poses.iter().fold(message, |message, (time, x)| message.header(*time, "map").pose(*x)).0
}

fn transform(time: f64, parent: &str, child: &str, x: f64) -> Vec<u8> {
    Cdr::new().u32(1).header(time, parent).text(child).pose(x).0
}

fn there() -> Vec<(String, String)> {
    let topics = [
        ("/points", "sensor_msgs/msg/PointCloud2"),
        ("/odom", "nav_msgs/msg/Odometry"),
        ("/plan", "nav_msgs/msg/Path"),
        ("/tf", "tf2_msgs/msg/TFMessage"),
        ("/imu", "sensor_msgs/msg/Imu"),
    ];
    topics.map(|(name, kind)| (name.to_owned(), kind.to_owned())).into()
}

/// Options that take every scan, and the messages sent to it one after the other, by topic.
fn played(options: &OpenOptions, messages: Vec<(&str, Vec<u8>)>) -> (Vec<Event>, LiveFrames) {
    let options = OpenOptions { keyframing: Some(Keyframing::All), ..options.clone() };
    let topics = LiveTopics::choose("test", &there(), false, &options).unwrap();
    let position = |name: &str| topics.subscriptions().iter().position(|topic| topic.name == name).unwrap();
    let (sender, receiver): (SyncSender<_>, _) = sync_channel(messages.len().max(1));
    messages.into_iter().for_each(|(name, data)| sender.send((position(name), data)).unwrap());
    drop(sender);
    let mut live = LiveEvents::new(topics, receiver, &options);
    let (mut events, frames) = (Vec::new(), live.frames());
    loop {
        match live.poll() {
            Polled::Item(Ok(event)) => events.push(event),
            Polled::Item(Err(error)) => assert!(error.to_string().contains("no pose"), "{error}"),
            Polled::Nothing => {}
            Polled::End => return (events, frames),
        }
    }
}

fn scan_positions(events: &[Event]) -> Vec<f64> {
    events.iter().filter_map(|event| if let Event::Scan(scan) = event { Some(scan.t_map_lidar.translation.x) } else { None }).collect()
}

#[test]
fn poses_come_by_topic_and_are_looked_up_in_time() {
    let messages = vec![
        ("/tf_static", transform(0.0, "base", "lidar", 0.5)),
        ("/points", cloud(10.05)),
        ("/odom", odometry(10.0, 1.0)),
        ("/odom", odometry(10.1, 2.0)),
        ("/odom", odometry(10.2, 3.0)),
    ];
    let (events, frames) = played(&OpenOptions::default(), messages);
    assert!((scan_positions(&events)[0] - 2.0).abs() < 1e-6, "half way from 1 to 2, and the lidar 0.5 ahead: {events:?}");
    assert_eq!((frames.odom().as_deref(), frames.lidar().as_deref()), (Some("odom"), Some("lidar")));
    assert_eq!(frames.base().map(|(name, pose)| (name, pose.translation.x)), Some(("base".to_owned(), -0.5)));
    assert!((frames.reported().unwrap().t_odom_lidar.translation.x - 2.0).abs() < 1e-6);
}

#[test]
fn poses_come_by_transforms() {
    let options = OpenOptions { pose_topic: Some("/tf".into()), ..OpenOptions::default() };
    let messages = vec![
        ("/tf", transform(10.0, "odom", "base", 1.0)),
        ("/tf", transform(10.0, "base", "lidar", 0.25)),
        ("/points", cloud(10.1)),
        ("/tf", transform(10.2, "odom", "base", 3.0)),
        ("/tf", transform(10.2, "base", "lidar", 0.25)),
    ];
    let (events, frames) = played(&options, messages);
    assert!((scan_positions(&events)[0] - 2.25).abs() < 1e-6);
    assert_eq!(frames.odom().as_deref(), Some("odom"));
}

#[test]
fn a_path_corrects_the_scans_that_came_before_it() {
    let options = OpenOptions { correction_topic: Some("corrected".into()), ..OpenOptions::default() };
    let mut messages = Vec::new();
    for k in 0..4 {
        let time = 10.0 + f64::from(k);
        messages.extend([("/odom", odometry(time, f64::from(k))), ("/odom", odometry(time + 0.2, f64::from(k))), ("/points", cloud(time))]);
        if k == 2 {
            // The last of three has no place in the path yet; the next scan is carried along.
            messages.push(("/corrected", path(&[(10.0, 0.0), (11.0, 1.5)])));
        }
    }
    let (events, _) = played(&options, messages);
    let update = events.iter().find_map(|event| if let Event::PoseUpdate(poses) = event { Some(poses) } else { None }).unwrap();
    let positions: Vec<(u64, f64)> = update.iter().map(|(node, pose)| (*node, pose.translation.x)).collect();
    assert_eq!(positions, [(0, 0.0), (1, 1.5)]);
    assert_eq!(scan_positions(&events), [0.0, 1.0, 2.0, 3.5]);
}

#[test]
fn a_clock_that_goes_back_is_noticed() {
    let mut messages = Vec::new();
    for (start, x) in [(100.0, 0.0), (20.0, 50.0)] {
        for k in 0..5 {
            let time = start + 0.1 * f64::from(k);
            messages.extend([("/odom", odometry(time, x + f64::from(k))), ("/points", cloud(time))]);
        }
    }
    let (events, _) = played(&OpenOptions::default(), messages);
    let positions = scan_positions(&events);
    assert_eq!(positions, [0.0, 1.0, 2.0, 3.0, 4.0, 50.0, 51.0, 52.0, 53.0, 54.0], "no pose of before is used for a scan after it");
}

#[test]
fn topics_are_found_by_type_or_named() {
    let chosen = |options: &OpenOptions, there: &[(String, String)], slam| LiveTopics::choose("DDS", there, slam, options);
    let names = |topics: &LiveTopics| topics.subscriptions().iter().map(|topic| topic.name.clone()).collect::<Vec<_>>();
    let usual = OpenOptions::default();
    assert_eq!(names(&chosen(&usual, &there(), false).unwrap()), ["/points", "/odom", "/tf", "/tf_static"]);
    assert_eq!(names(&chosen(&usual, &there(), true).unwrap()), ["/points", "/imu", "/tf", "/tf_static"]);
    let mut more = there();
    more.push(("/rear".into(), "sensor_msgs/msg/PointCloud2".into()));
    assert!(chosen(&usual, &more, false).unwrap_err().to_string().contains("/rear"));
    let named = OpenOptions { cloud_topic: Some("rear".into()), ..usual.clone() };
    assert_eq!(names(&chosen(&named, &more, false).unwrap())[0], "/rear");
    let without: Vec<_> = there().into_iter().filter(|(name, _)| name != "/odom" && name != "/tf").collect();
    assert!(matches!(chosen(&usual, &without, false), Err(crate::Error::NoPoses { .. })));
    assert!(chosen(&usual, &[], false).unwrap_err().to_string().starts_with("DDS"));
}

#[test]
fn garbage_is_an_error_and_never_a_panic() {
    let options = OpenOptions::default();
    let whole = [cloud(1.0), odometry(1.0, 2.0), path(&[(1.0, 1.0)]), transform(1.0, "a", "b", 1.0)];
    let topics = LiveTopics::choose("test", &there(), false, &OpenOptions { correction_topic: Some("c".into()), ..options.clone() }).unwrap();
    let (sender, receiver) = sync_channel(1 << 16);
    let mut random = 1u64;
    let mut next = |below: usize| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) as usize % below
    };
    let count = 20_000;
    for _ in 0..count {
        let mut data = whole[next(whole.len())].clone();
        match next(3) {
            0 => data.truncate(next(data.len())),
            1 => {
                let at = next(data.len());
                data[at] = next(256) as u8;
            }
            _ => (0..8).for_each(|_| {
                let at = next(data.len());
                data[at] ^= 1 << next(8);
            }),
        }
        sender.send((next(7), data)).unwrap();
    }
    drop(sender);
    let mut live = LiveEvents::new(topics, receiver, &options);
    let (mut errors, mut steps) = (0, 0usize);
    loop {
        match live.poll() {
            Polled::Item(Err(_)) => errors += 1,
            Polled::Item(Ok(_)) | Polled::Nothing => {}
            Polled::End => break,
        }
        steps += 1;
    }
    assert!(errors > count / 10 && steps >= count, "{errors} errors in {steps} steps");
}
