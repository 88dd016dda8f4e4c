//! Notices where the clock of the messages goes back.

use super::message_stream::{MessageStream, SensorMessage};
use crate::Result;
use std::collections::HashMap;

/// A stamp that is this much older than the newest of its source, seconds, means that the clock went back: a robot or a simulation was started again. What a
/// network brings out of order is less far apart.
const LARGEST_DISORDER_S: f64 = 1.0;

/// A source of stamps that come in order.
#[derive(PartialEq, Eq, Hash)]
enum StampSource {
    /// Clouds of a sensor.
    Sensor(u16),
    /// Messages with poses.
    Poses,
    /// Transforms of a frame, which may move.
    Frame(String),
}

/// A stream, with a [`SensorMessage::ClockJump`] before the first message of each new time. Each source has its own stamps: poses may come long after their scans.
pub(crate) struct ClockWatch {
    stream: Box<dyn MessageStream>,
    /// The newest stamp of each source since the last jump, seconds.
    newest: HashMap<StampSource, f64>,
    /// The message that showed a jump.
    pending: Option<SensorMessage>,
}

impl ClockWatch {
    pub(crate) fn new(stream: Box<dyn MessageStream>) -> Self {
        Self { stream, newest: HashMap::new(), pending: None }
    }

    /// By how many seconds the clock went back before this message, if it did.
    fn note(&mut self, message: &SensorMessage) -> Option<f64> {
        let (source, time) = match message {
            SensorMessage::Cloud(cloud) => (StampSource::Sensor(cloud.sensor), cloud.time),
            SensorMessage::Pose { time, is_last: true, .. } => (StampSource::Poses, *time),
            SensorMessage::Transform { time, child, is_fixed: false, .. } => (StampSource::Frame(child.clone()), *time),
            SensorMessage::ClockJump => {
                self.newest.clear();
                return None;
            }
            _ => return None,
        };
        let newest = self.newest.get(&source).copied().unwrap_or(time);
        let is_jump = time < newest - LARGEST_DISORDER_S;
        if is_jump {
            self.newest.clear();
        }
        self.newest.insert(source, if is_jump { time } else { newest.max(time) });
        is_jump.then_some(newest - time)
    }
}

impl MessageStream for ClockWatch {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.pending.take() {
            return Some(Ok(message));
        }
        let message = self.stream.next()?;
        let Some(back) = message.as_ref().ok().and_then(|message| self.note(message)) else { return Some(message) };
        tracing::warn!("the clock of the messages went back by {back:.1} s: the poses that came before are not used any more");
        self.pending = message.ok();
        Some(Ok(SensorMessage::ClockJump))
    }

    fn now(&self) -> f64 {
        self.stream.now()
    }
}

#[cfg(test)]
mod tests {
    use super::super::message_stream::CloudMessage;
    use super::super::player::{Player, PlayerOptions};
    use super::super::pose_lookup::{PoseSource, SensorMounts};
    use super::super::{Corrections, PlaybackLog, Selection};
    use super::*;
    use crate::scan_list::{KeyframeFilter, Keyframing};
    use crate::stamped_cloud::{StampedCloud, SweepTime};
    use std::sync::Arc;
    use voxelastic::event::Event;
    use voxelastic::geometry::PoseChange;
    use voxelastic::{Cloud, Pose};

    struct Played(std::vec::IntoIter<SensorMessage>, f64);

    impl MessageStream for Played {
        fn next(&mut self) -> Option<Result<SensorMessage>> {
            self.1 += 0.01;
            self.0.next().map(Ok)
        }

        fn now(&self) -> f64 {
            self.1
        }
    }

    fn scan(sensor: u16, time: f64) -> SensorMessage {
        let decode = || Ok(StampedCloud::new(Cloud { points: vec![[1.0, 2.0, 3.0]], ..Cloud::default() }, None));
        SensorMessage::Cloud(CloudMessage {
            time,
            frame: "lidar".into(),
            sensor,
            sweep: SweepTime::default(),
            has_times: false,
            bytes: 1,
            decode: Box::new(decode),
        })
    }

    /// A pose at x, of a message of which it is the last or not.
    fn pose(time: f64, x: f64, is_last: bool) -> SensorMessage {
        SensorMessage::Pose { time, parent: "odom".into(), child: "lidar".into(), pose: Pose::translation(x, 0.0, 0.0), is_last }
    }

    fn transform(time: f64, x: f64) -> SensorMessage {
        SensorMessage::Transform { time, parent: "odom".into(), child: "lidar".into(), pose: Pose::translation(x, 0.0, 0.0), is_fixed: false }
    }

    /// Where the scans are.
    fn places(messages: Vec<SensorMessage>) -> Vec<f64> {
        let by_transforms = messages.iter().any(|message| matches!(message, SensorMessage::Transform { .. }));
        let track = PoseSource::of_topic();
        let options = PlayerOptions {
            path: "recording".into(),
            poses: if by_transforms { PoseSource::Transforms } else { track },
            mounts: SensorMounts::default(),
            keyframes: KeyframeFilter::new(Keyframing::All),
            selection: Selection::default(),
            nodes: None,
            corrections: Corrections::default(),
            pose_change: PoseChange::default(),
            tolerance_s: 0.01,
            deskew: true,
            log: Arc::new(PlaybackLog::default()),
            mount_timeout_s: None,
        };
        let player = Player::new(Box::new(Played(messages.into_iter(), 0.0)), options);
        player.filter_map(|event| if let Ok(Event::Scan(scan)) = event { Some(scan.t_map_lidar.translation.x) } else { None }).collect()
    }

    /// A robot that is started again, with a clock that says 20 s and not 100: each of its scans comes before its pose, or after it.
    fn restarted(scans_first: bool, pose: impl Fn(f64, f64) -> SensorMessage) -> Vec<SensorMessage> {
        let mut messages = Vec::new();
        for k in 0..10 {
            let time = if k < 5 { 100.0 } else { 20.0 } + 0.1 * f64::from(k);
            let pair = [scan(0, time), pose(time, f64::from(k))];
            messages.extend(if scans_first { pair.into_iter().collect::<Vec<_>>() } else { pair.into_iter().rev().collect() });
        }
        messages
    }

    #[test]
    fn every_scan_of_a_recording_with_an_earlier_clock_has_its_pose() {
        let all: Vec<f64> = (0..10).map(f64::from).collect();
        for scans_first in [false, true] {
            assert_eq!(places(restarted(scans_first, |time, x| pose(time, x, true))), all, "poses, scans first: {scans_first}");
            assert_eq!(places(restarted(scans_first, transform)), all, "transforms, scans first: {scans_first}");
        }
    }

    #[test]
    fn poses_that_come_late_are_kept() {
        // Five seconds after their scans.
        let mut messages: Vec<SensorMessage> = (0..50).map(|k| scan(0, 0.1 * f64::from(k))).collect();
        messages.extend((0..50).map(|k| pose(0.1 * f64::from(k), f64::from(k), true)));
        assert_eq!(places(messages), (0..50).map(f64::from).collect::<Vec<_>>());
        // And all of them before their scans.
        let mut messages: Vec<SensorMessage> = (0..50).map(|k| pose(0.1 * f64::from(k), f64::from(k), true)).collect();
        messages.extend((0..50).map(|k| scan(0, 0.1 * f64::from(k))));
        assert_eq!(places(messages), (0..50).map(f64::from).collect::<Vec<_>>());
    }

    #[test]
    fn a_path_that_is_sent_again_is_no_jump() {
        let mut messages = Vec::new();
        for k in 0..30 {
            messages.push(scan(0, f64::from(k)));
            messages.extend((0..=k).map(|j| pose(f64::from(j), f64::from(j), j == k)));
        }
        let mut watch = ClockWatch::new(Box::new(Played(messages.into_iter(), 0.0)));
        assert!(std::iter::from_fn(|| watch.next()).all(|message| !matches!(message, Ok(SensorMessage::ClockJump))));
    }

    #[test]
    fn each_sensor_has_its_own_clock() {
        let messages: Vec<SensorMessage> = (0..20).flat_map(|k| [scan(0, f64::from(k)), scan(1, 1000.0 + f64::from(k))]).collect();
        let mut watch = ClockWatch::new(Box::new(Played(messages.into_iter(), 0.0)));
        assert!(std::iter::from_fn(|| watch.next()).all(|message| matches!(message, Ok(SensorMessage::Cloud(_)))));
    }
}
