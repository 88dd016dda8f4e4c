//! Where the lidars of a robot are on it: late, otherwise than before, and several of them.

use super::tests::{at, clock, cloud, cloud_of, odometry, played, scan_positions, there, transform};
use super::*;
use crate::{OpenOptions, SensorTopic};
use voxelastic::event::Event;

/// A scan and the pose of its time, after the clock has come to it.
fn moment(time: f64, x: f64) -> [(&'static str, Vec<u8>); 3] {
    [("/clock", clock(time)), ("/odom", odometry(time, x)), ("/points", cloud(time))]
}

#[test]
fn without_the_mount_nothing_is_mapped_however_long_it_takes() {
    let mut messages: Vec<_> = (0..30u8).flat_map(|k| moment(10.0 + f64::from(k), f64::from(k))).collect();
    messages.push(("/tf_static", transform(0.0, "base", "lidar", 0.5)));
    messages.extend((30..33u8).flat_map(|k| moment(10.0 + f64::from(k), f64::from(k))));
    let (events, frames) = played(&OpenOptions::default(), messages);
    let positions = scan_positions(&events);
    assert!(positions.ends_with(&[30.5, 31.5, 32.5]) && positions.iter().all(|x| x.fract() == 0.5), "{positions:?}");
    assert_eq!((positions.len() + frames.without_pose(), frames.waits_for()), (33, None));
}

#[test]
fn it_is_said_what_is_missing_and_assumed_only_on_request() {
    let messages: Vec<_> = (0..12u8).flat_map(|k| moment(10.0 + f64::from(k), f64::from(k))).collect();
    let (events, frames) = played(&OpenOptions::default(), messages.clone());
    assert_eq!((scan_positions(&events).len(), frames.without_pose()), (0, 12));
    assert!(frames.waits_for().unwrap().contains("no fixed transform leads from base to lidar"));
    let assumed = OpenOptions { mount_timeout_s: Some(4.0), ..OpenOptions::default() };
    let (events, frames) = played(&assumed, messages);
    assert!(scan_positions(&events).ends_with(&[10.0, 11.0]) && frames.waits_for().is_none(), "{:?}", scan_positions(&events));
}

#[test]
fn clouds_that_an_odometry_has_moved_are_moved_back() {
    let moved: Vec<_> =
        (1..4u8).flat_map(|k| [("/odom", odometry(f64::from(k), f64::from(k))), ("/points", cloud_of(f64::from(k), "odom"))]).collect();
    for (given, behind) in [(None, 0.0), (Some(at(0.25)), 0.25)] {
        let (events, frames) = played(&OpenOptions { t_base_lidar: given, ..OpenOptions::default() }, moved.clone());
        let scans: Vec<_> = events.iter().filter_map(|event| if let Event::Scan(scan) = event { Some(scan) } else { None }).collect();
        assert_eq!(scan_positions(&events), [1.0, 2.0, 3.0].map(|x| x + behind));
        for (k, scan) in scans.iter().enumerate() {
            let x = 5.0 - (k as f32 + 1.0 + behind as f32);
            assert!((scan.cloud.points[0][0] - x).abs() < 1e-6, "{:?}", scan.cloud.points);
        }
        assert_eq!((frames.lidar().as_deref(), frames.odom().as_deref(), frames.waits_for()), (Some("base"), Some("odom"), None));
    }
}

#[test]
fn another_mount_is_taken_and_what_was_mapped_is_moved() {
    let mut messages = vec![("/tf_static", transform(0.0, "base", "lidar", 0.5))];
    messages.extend((0..3u8).flat_map(|k| [("/odom", odometry(f64::from(k), f64::from(k))), ("/points", cloud(f64::from(k)))]));
    // The same again, as some programs send it every second, is nothing new.
    messages.push(("/tf_static", transform(1.0, "base", "lidar", 0.5)));
    messages.push(("/tf_static", transform(2.0, "base", "lidar", 0.75)));
    messages.extend([("/odom", odometry(3.0, 3.0)), ("/points", cloud(3.0))]);
    let (events, frames) = played(&OpenOptions::default(), messages);
    assert_eq!(scan_positions(&events), [0.5, 1.5, 2.5, 3.75]);
    let updates: Vec<_> = events.iter().filter_map(|event| if let Event::PoseUpdate(poses) = event { Some(poses) } else { None }).collect();
    let moved: Vec<f64> = updates[0].iter().map(|(_, pose)| pose.translation.x).collect();
    assert!(updates.len() == 1 && moved.iter().zip([0.75, 1.75, 2.75]).all(|(x, right)| (x - right).abs() < 1e-9), "{updates:?}");
    let edges = events.iter().filter_map(|event| if let Event::OdometryEdge(edge) = event { Some(edge.t_from_to.translation.x) } else { None });
    assert!(edges.clone().count() == 3 && edges.into_iter().all(|x| (x - 1.0).abs() < 1e-9), "the robot moved as it did");
    let notes = frames.take_notes();
    assert!(notes.len() == 1 && notes[0].contains("0.250 m") && frames.take_notes().is_empty(), "{notes:?}");
    // What the user says is not changed by anybody.
    let given = OpenOptions { t_base_lidar: Some(at(0.1)), ..OpenOptions::default() };
    let messages = vec![
        ("/odom", odometry(0.0, 0.0)),
        ("/points", cloud(0.0)),
        ("/tf_static", transform(0.0, "base", "lidar", 0.5)),
        ("/odom", odometry(1.0, 1.0)),
        ("/points", cloud(1.0)),
    ];
    assert_eq!(scan_positions(&played(&given, messages).0), [0.1, 1.1]);
}

#[test]
fn two_lidars_are_mapped_together() {
    let options = |rear| OpenOptions {
        cloud_topic: Some("/points".into()),
        more_sensors: vec![SensorTopic { topic: "/rear".into(), t_base_lidar: rear }],
        ..OpenOptions::default()
    };
    let mut messages = vec![("/tf_static", transform(0.0, "base", "lidar", 0.5)), ("/tf_static", transform(0.0, "base", "lidar2", -0.25))];
    messages.extend((0..2u8).flat_map(|k| {
        let time = f64::from(k);
        [("/odom", odometry(time, time)), ("/points", cloud(time)), ("/rear", cloud_of(time, "lidar2"))]
    }));
    let (events, frames) = played(&options(None), messages.clone());
    let scans: Vec<(u16, f64)> = events
        .iter()
        .filter_map(|event| if let Event::Scan(scan) = event { Some((scan.cloud.sensor, scan.t_map_lidar.translation.x)) } else { None })
        .collect();
    assert_eq!(scans, [(0, 0.5), (1, -0.25), (0, 1.5), (1, 0.75)]);
    assert_eq!(frames.lidar().as_deref(), Some("lidar"));
    assert_eq!(scan_positions(&played(&options(Some(at(-0.5))), messages).0), [0.5, -0.5, 1.5, 0.5]);
    let twice = OpenOptions { more_sensors: vec![SensorTopic { topic: "points".into(), t_base_lidar: None }], ..options(None) };
    assert!(LiveTopics::choose("test", &there(), false, &twice).unwrap_err().to_string().contains("named twice"));
}

#[test]
fn who_else_publishes_a_transform_is_known() {
    let frames = LiveFrames::default();
    assert!(!frames.is_published_here(["map", "odom"], 5.0));
    frames.note_published("odom", 5.0);
    assert!(frames.is_published_here(["map", "odom"], 5.0) && frames.rival().is_none(), "it comes back from the network");
    assert!(frames.is_published_here(["world", "odom"], 5.5) && !frames.is_published_here(["odom", "base"], 5.0));
    assert_eq!(frames.rival(), Some(["world", "odom"].map(str::to_owned)));
}
