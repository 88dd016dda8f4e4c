//! Scans with poses, or raw scans, from the messages of topics.

use super::super::description::KEYFRAME_DISTANCE_M;
use super::super::raw_player::{RawPlayer, RecordedScan};
use super::stream::LiveStream;
use super::{LiveFrames, LiveMessages, LiveTopics, Polled, SensorPacket};
use crate::capture::SpinningStream;
use crate::motion::ImuMount;
use crate::ouster::{PacketStream, SensorMetadata};
use crate::playback::{Corrections, PlaybackLog, Player, PlayerOptions, PoseSource, Selection, SensorMounts};
use crate::raw::TimedScan;
use crate::scan_list::{KeyframeFilter, Keyframing};
use crate::{OpenOptions, PointTimes, Result};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use voxelastic::Pose;
use voxelastic::event::Event;

/// The registered cloud list of a robot that runs.
pub struct LiveEvents {
    player: Player,
    frames: LiveFrames,
}

impl LiveEvents {
    /// Of the messages of chosen topics. It ends when their sender does.
    pub fn new(topics: LiveTopics, messages: LiveMessages, options: &OpenOptions) -> Self {
        let log = Arc::new(PlaybackLog::of_passing_scans());
        let frames = LiveFrames::new(Arc::clone(&log));
        let track = PoseSource::of_topic();
        let player_options = PlayerOptions {
            path: topics.origin.clone(),
            poses: if topics.by_transforms { PoseSource::Transforms } else { track },
            mounts: mounts(options),
            keyframes: KeyframeFilter::new(options.keyframing.unwrap_or(Keyframing::Metres(KEYFRAME_DISTANCE_M))),
            selection: Selection::default(),
            nodes: None,
            corrections: if topics.stream.corrections.is_some() { Corrections::by_message() } else { Corrections::default() },
            pose_change: options.pose_change,
            tolerance_s: options.time_tolerance_s,
            deskew: options.point_times != PointTimes::Undistorted,
            log,
            mount_timeout_s: options.mount_timeout_s,
        };
        let stream = LiveStream::new(topics, messages, frames.clone());
        Self { player: Player::new(Box::new(stream), player_options), frames }
    }

    /// One step, which waits some milliseconds for a message if there is none.
    pub fn poll(&mut self) -> Polled<Result<Event>> {
        self.player.poll()
    }

    /// The frames of what comes.
    pub fn frames(&self) -> LiveFrames {
        self.frames.clone()
    }
}

/// The raw scans of a robot that runs: clouds, each with the samples of the inertial measurement unit up to its end.
pub struct LiveScans {
    player: RawPlayer,
    frames: LiveFrames,
}

impl LiveScans {
    /// Of the messages of chosen topics. It ends when their sender does.
    pub fn new(topics: LiveTopics, messages: LiveMessages) -> Self {
        let log = Arc::new(PlaybackLog::of_passing_scans());
        let frames = LiveFrames::new(Arc::clone(&log));
        // The stream gives samples at the lidar already: where the unit is becomes known with the transforms.
        let mount = topics.stream.imu.is_some().then(|| ImuMount::new(Pose::identity()));
        let stream = LiveStream::new(topics, messages, frames.clone());
        Self { player: RawPlayer::new(Box::new(stream), mount, log), frames }
    }

    /// Of the datagrams of an Ouster sensor, as they come from `origin`; those of its inertial measurement unit among them if `use_imu`. The first source with
    /// some that belong together is the sensor, until it is silent. It ends when their sender does.
    pub fn of_ouster(metadata: SensorMetadata, packets: Receiver<SensorPacket>, origin: &str, use_imu: bool) -> Self {
        let log = Arc::new(PlaybackLog::of_passing_scans());
        let mount = use_imu.then(|| ImuMount::new(metadata.t_sensor_imu));
        let stream = PacketStream::new(metadata, packets, origin.into());
        Self { player: RawPlayer::new(Box::new(stream), mount, Arc::clone(&log)), frames: LiveFrames::new(log) }
    }

    /// Of the datagrams of a sensor that turns, Velodyne's or Hesai's, as they come from `origin`. The first that belong together say which it is, until it is silent; a Hesai has the
    /// `angles` of a file, if one is given. It ends when their sender does.
    pub fn of_spinning(packets: Receiver<SensorPacket>, origin: &str, angles: Option<PathBuf>) -> Self {
        let log = Arc::new(PlaybackLog::of_passing_scans());
        let stream = SpinningStream::new(packets, angles, origin.into());
        Self { player: RawPlayer::new(Box::new(stream), None, Arc::clone(&log)), frames: LiveFrames::new(log) }
    }

    /// One step, which waits some milliseconds for a message if there is none.
    pub fn poll(&mut self) -> Polled<Result<TimedScan>> {
        match self.player.poll() {
            Polled::Item(scan) => Polled::Item(scan.map(timed)),
            Polled::Nothing => Polled::Nothing,
            Polled::End => Polled::End,
        }
    }

    /// The frames of what comes.
    pub fn frames(&self) -> LiveFrames {
        self.frames.clone()
    }
}

/// Where the lidars of a robot are on it, as far as the user says.
fn mounts(options: &OpenOptions) -> SensorMounts {
    let further = options.more_sensors.iter().map(|sensor| sensor.t_base_lidar);
    SensorMounts { given: std::iter::once(options.t_base_lidar).chain(further).collect(), is_live: true, ..SensorMounts::default() }
}

fn timed(scan: RecordedScan) -> TimedScan {
    let RecordedScan { index, node, time, cloud, imu } = scan;
    TimedScan { name: index.to_string(), index, node, time, sweep: None, cloud, imu }
}
