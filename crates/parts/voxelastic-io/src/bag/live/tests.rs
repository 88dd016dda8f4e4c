//! Messages as a middleware delivers them.

use super::*;
use crate::OpenOptions;
use crate::ros::{FieldType, Header, MessageWriter, point_cloud, transforms};
use crate::scan_list::Keyframing;
use std::sync::mpsc::{SyncSender, sync_channel};
use voxelastic::Pose;
use voxelastic::event::Event;

fn header(time: f64, frame: &str) -> Header<'_> {
    Header { stamp: time, frame }
}

pub(super) fn at(x: f64) -> Pose {
    Pose::translation(x, 0.0, 0.0)
}

pub(super) fn cloud(time: f64) -> Vec<u8> {
    cloud_of(time, "lidar")
}

pub(super) fn cloud_of(time: f64, frame: &str) -> Vec<u8> {
    let data: Vec<u8> = [5.0f32, 0.0, 1.0, 0.0, 6.0, 1.0].iter().flat_map(|v| v.to_le_bytes()).collect();
    point_cloud(header(time, frame), [1, 2], &["x", "y", "z"].map(|name| (name, FieldType::F32)), &data, true)
}

pub(super) fn odometry(time: f64, x: f64) -> Vec<u8> {
    MessageWriter::new().header(header(time, "odom")).text("base").pose(&at(x)).finish()
}

fn path(poses: &[(f64, f64)]) -> Vec<u8> {
    let mut message = MessageWriter::new();
    message.header(header(0.0, "map")).u32(poses.len() as u32);
    poses.iter().for_each(|(time, x)| _ = message.header(header(*time, "map")).pose(&at(*x)));
    message.finish()
}

pub(super) fn transform(time: f64, parent: &str, child: &str, x: f64) -> Vec<u8> {
    transforms(&[(header(time, parent), child, at(x))])
}

pub(super) fn there() -> Vec<(String, String)> {
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
pub(super) fn played(options: &OpenOptions, messages: Vec<(&str, Vec<u8>)>) -> (Vec<Event>, LiveFrames) {
    let options = OpenOptions { keyframing: Some(Keyframing::All), ..options.clone() };
    let mut there = there();
    there.extend(options.more_sensors.iter().map(|sensor| (sensor.topic.clone(), "sensor_msgs/msg/PointCloud2".to_owned())));
    let topics = LiveTopics::choose("test", &there, false, &options).unwrap();
    let topics = if messages.iter().any(|(name, _)| *name == "/clock") { topics.with_clock() } else { topics };
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

pub(super) fn scan_positions(events: &[Event]) -> Vec<f64> {
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
fn scans_wait_for_the_transform_that_says_where_the_lidar_is() {
    let mut messages: Vec<_> = (0..3).flat_map(|k| [("/odom", odometry(f64::from(k), f64::from(k))), ("/points", cloud(f64::from(k)))]).collect();
    messages.insert(4, ("/tf_static", transform(0.0, "base", "lidar", 0.5)));
    let (events, _) = played(&OpenOptions::default(), messages);
    assert_eq!(scan_positions(&events), [0.5, 1.5, 2.5]);
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
    let mut messages = vec![("/tf_static", transform(0.0, "base", "lidar", 0.0))];
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

/// Where the lidar is on the robot: without it nothing is mapped.
fn mount() -> (&'static str, Vec<u8>) {
    ("/tf_static", transform(0.0, "base", "lidar", 0.0))
}

#[test]
fn a_clock_that_goes_back_is_noticed() {
    let mut messages = vec![mount()];
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

pub(super) fn clock(time: f64) -> Vec<u8> {
    MessageWriter::new().time(time).finish()
}

#[test]
fn scans_wait_for_poses_in_the_time_of_the_simulation() {
    // Seven seconds pass at once.
    let messages = vec![
        mount(),
        ("/clock", clock(10.0)),
        ("/odom", odometry(10.0, 1.0)),
        ("/points", cloud(12.0)),
        ("/clock", clock(17.0)),
        ("/points", cloud(17.5)),
        ("/odom", odometry(17.4, 2.0)),
        ("/odom", odometry(17.6, 3.0)),
    ];
    let begin = std::time::Instant::now();
    let (events, frames) = played(&OpenOptions::default(), messages);
    assert!(begin.elapsed().as_secs_f64() < 5.0, "it waited for {:.1} s", begin.elapsed().as_secs_f64());
    assert!((scan_positions(&events)[0] - 2.5).abs() < 1e-6 && events.len() == 1, "{events:?}");
    assert_eq!(frames.without_pose(), 1);
}

#[test]
fn a_simulation_that_is_started_again_uses_no_pose_of_after_for_a_scan_of_before() {
    let tick = |time: f64| ("/clock", clock(time));
    let scan = |time: f64| ("/points", cloud(time));
    for source in ["/odom", "/tf"] {
        let pose = |time: f64, x: f64| (source, if source == "/tf" { transform(time, "odom", "lidar", x) } else { odometry(time, x) });
        let mut messages = if source == "/tf" { vec![tick(30.0)] } else { vec![mount(), tick(30.0)] };
        for k in 0..3 {
            let time = 30.0 + 0.1 * f64::from(k);
            messages.extend([tick(time), pose(time, f64::from(k)), scan(time)]);
        }
        // It waits for a pose when the clock goes back. The second run comes to this time again, elsewhere.
        messages.extend([scan(30.35), tick(29.0)]);
        // Messages of the first run that were under way.
        messages.extend([pose(30.3, 3.0), pose(30.4, 4.0), scan(30.4)]);
        for k in 0..20 {
            let time = 29.0 + 0.1 * f64::from(k);
            messages.extend([tick(time), pose(time, 100.0 + f64::from(k)), scan(time)]);
        }
        let options = OpenOptions { pose_topic: Some(source.into()), ..OpenOptions::default() };
        let (events, frames) = played(&options, messages);
        let expected: Vec<f64> = (0..3).map(f64::from).chain((100..120).map(f64::from)).collect();
        assert_eq!(scan_positions(&events), expected, "{source}");
        assert_eq!(frames.without_pose(), 1, "{source}: the scan that waited");
    }
}

#[test]
fn samples_of_before_do_not_belong_to_scans_of_after() {
    let imu = |time: f64| {
        MessageWriter::new()
            .header(header(time, "lidar"))
            .f64s(&[0.0, 0.0, 0.0, 1.0])
            .f64s(&[0.0; 9])
            .f64s(&[0.0; 3])
            .f64s(&[0.0; 9])
            .f64s(&[0.0, 0.0, 9.8])
            .f64s(&[0.0; 9])
            .finish()
    };
    let topics = LiveTopics::choose("test", &there(), true, &OpenOptions::default()).unwrap().with_clock();
    let position = |name: &str| topics.subscriptions().iter().position(|topic| topic.name == name).unwrap();
    let (sender, receiver) = sync_channel(100);
    let send = |name: &str, data: Vec<u8>| sender.send((position(name), data)).unwrap();
    for start in [100.0, 0.0] {
        send("/clock", clock(start));
        // The first cloud says in which frame the lidar is.
        send("/points", cloud(start));
        (0..5).for_each(|k| send("/imu", imu(start + 0.01 * f64::from(k))));
        send("/points", cloud(start + 0.02));
        send("/points", cloud(start + 0.05));
    }
    drop(sender);
    let mut live = LiveScans::new(topics.clone(), receiver);
    let mut samples = Vec::new();
    loop {
        match live.poll() {
            Polled::Item(scan) => samples.push(scan.unwrap().imu.iter().map(|sample| sample.time).collect::<Vec<_>>()),
            Polled::Nothing => {}
            Polled::End => break,
        }
    }
    assert_eq!(samples.len(), 6);
    assert!(samples[..3].iter().flatten().all(|time| *time >= 100.0) && samples[3..].iter().flatten().all(|time| *time < 1.0), "{samples:?}");
    assert!(!samples[1].is_empty() && !samples[4].is_empty(), "{samples:?}");
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
fn nothing_is_kept_of_a_scan_that_comes_only_once() {
    let messages = (0..20).flat_map(|k| {
        let time = 10.0 + 0.1 * f64::from(k);
        [("/odom", odometry(time, f64::from(k))), ("/points", cloud(time))]
    });
    let (events, frames) = played(&OpenOptions::default(), std::iter::once(mount()).chain(messages).collect());
    assert_eq!(scan_positions(&events).len(), 20);
    assert_eq!(frames.kept(), 0, "what would read a scan again");
}

fn livox(time: f64) -> Vec<u8> {
    // Time base, counts, lidar, reserved; two points with time, place, reflectivity, tag and line.
    let mut message = MessageWriter::new();
    message.header(header(time, "lidar")).u32(0).u32(0).u32(2).u8(1).u8(0).u8(0).u8(0).u32(2);
    for k in 0..2u32 {
        message.u32(k).u32(5f32.to_bits()).u32(1f32.to_bits()).u32(0).u8(9).u8(0).u8(1);
    }
    message.finish()
}

/// All that can be subscribed to, by type: the robots that have it, and whether poses are estimated.
fn robots() -> Vec<(LiveTopics, Vec<Vec<u8>>)> {
    let imu = MessageWriter::new()
        .header(header(1.0, "lidar"))
        .f64s(&[0.0; 4])
        .f64s(&[0.0; 9])
        .f64s(&[0.0; 3])
        .f64s(&[0.0; 9])
        .f64s(&[0.0; 3])
        .f64s(&[0.0; 9])
        .finish();
    let pose = MessageWriter::new().header(header(1.0, "map")).pose(&at(1.0)).finish();
    let whole = vec![cloud(1.0), livox(1.0), odometry(1.0, 2.0), pose, path(&[(1.0, 1.0)]), transform(1.0, "a", "b", 1.0), imu, clock(1.0)];
    let kinds = |pairs: &[(&str, &str)]| pairs.iter().map(|(name, kind)| ((*name).to_owned(), (*kind).to_owned())).collect::<Vec<_>>();
    let corrected = OpenOptions { correction_topic: Some("c".into()), ..OpenOptions::default() };
    let by_transforms = OpenOptions { pose_topic: Some("/tf".into()), ..OpenOptions::default() };
    let other =
        kinds(&[("/livox", "livox_ros_driver2/msg/CustomMsg"), ("/pose", "geometry_msgs/msg/PoseStamped"), ("/tf", "tf2_msgs/msg/TFMessage")]);
    let covariant = kinds(&[("/points", "sensor_msgs/msg/PointCloud2"), ("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped")]);
    let chosen = [
        LiveTopics::choose("test", &there(), false, &corrected),
        LiveTopics::choose("test", &there(), true, &OpenOptions::default()),
        LiveTopics::choose("test", &other, false, &OpenOptions::default()),
        LiveTopics::choose("test", &other, false, &by_transforms),
        LiveTopics::choose("test", &covariant, false, &OpenOptions::default()),
    ];
    chosen.into_iter().map(|topics| (topics.unwrap().with_clock(), whole.clone())).collect()
}

#[test]
fn garbage_on_every_topic_is_an_error_and_never_a_panic() {
    for (topics, whole) in robots() {
        let subscribed = topics.subscriptions().len();
        let (sender, receiver) = sync_channel(1 << 16);
        let mut random = 1u64;
        let mut next = |below: usize| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as usize % below
        };
        let count = 20_000;
        for _ in 0..count {
            let mut data = whole[next(whole.len())].clone();
            match next(4) {
                0 => data.truncate(next(data.len())),
                1 => {
                    let at = next(data.len());
                    data[at] = next(256) as u8;
                }
                2 => data = (0..next(200)).map(|_| next(256) as u8).collect(),
                _ => (0..8).for_each(|_| {
                    let at = next(data.len());
                    data[at] ^= 1 << next(8);
                }),
            }
            // One topic more than there is.
            sender.send((next(subscribed + 1), data)).unwrap();
        }
        drop(sender);
        let is_raw = topics.stream.imu.is_some();
        let description = topics.description();
        let mut poll: Box<dyn FnMut() -> Option<bool>> = if is_raw {
            let mut live = LiveScans::new(topics, receiver);
            Box::new(move || is_error(&live.poll()))
        } else {
            let mut live = LiveEvents::new(topics, receiver, &OpenOptions::default());
            Box::new(move || is_error(&live.poll()))
        };
        let (mut errors, mut steps) = (0, 0usize);
        while let Some(is_error) = poll() {
            errors += usize::from(is_error);
            steps += 1;
        }
        assert!(errors > count / 10 && steps >= count, "{description}: {errors} errors in {steps} steps");
    }
}

/// None at the end.
fn is_error<T>(polled: &Polled<crate::Result<T>>) -> Option<bool> {
    match polled {
        Polled::Item(item) => Some(item.is_err()),
        Polled::Nothing => Some(false),
        Polled::End => None,
    }
}
