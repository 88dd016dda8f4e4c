//! The clouds of a recording without poses.

use super::describe::{describe_bag, describe_capture, is_capture, summarise};
use super::packet_topics::PacketTopics;
use super::raw_player::{RawPlayer, RecordedScan};
use super::stream::{BagStream, StreamTopics};
use super::topics::{choose_clouds, choose_further_clouds, choose_imu, further_frames, mounted_beside, refuse_registered};
use crate::capture::CaptureKind;
use crate::motion::ImuMount;
use crate::playback::{CloudRereader, MessageStream, OpenStream, PlaybackLog};
use crate::stamped_cloud::Interval;
use crate::{OpenOptions, PointTimes, Result};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;

/// A recording whose cloud topic has been chosen. Only its beginning has been read.
#[derive(Clone)]
pub(crate) struct RawRecording {
    path: PathBuf,
    /// How a capture is read.
    capture: Option<CaptureKind>,
    open: OpenStream,
    /// The sensor's own tables of beams, of a topic with packets.
    model: Option<Box<BeamModel>>,
    /// Number of clouds, if known.
    count: Option<usize>,
    /// The usual time between the clouds of the first sensor, seconds.
    interval_s: Option<f64>,
    /// What speaks for clouds that are undistorted already, although their points have times.
    undistorted_sign: Option<String>,
    description: String,
    /// Where the inertial measurement unit is in the lidar frame, if one is used.
    t_lidar_imu: Option<Pose>,
    /// Pose of each further sensor in the frame of the first.
    t_first_sensor: Vec<Pose>,
    log: Arc<PlaybackLog>,
}

impl fmt::Debug for RawRecording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RawRecording").field("path", &self.path).finish_non_exhaustive()
    }
}

impl RawRecording {
    /// Opens a recording.
    ///
    /// # Errors
    /// [`Error::Ambiguous`](crate::Error::Ambiguous) if several topics hold clouds; [`Error::Dataset`](crate::Error::Dataset) if none does; as
    /// [`describe`](super::describe()).
    pub(crate) fn open(path: &Path, options: &OpenOptions) -> Result<Self> {
        let log = Arc::default();
        if is_capture(path)? {
            let (kind, description) = describe_capture(path, options)?;
            let (capture, read) = (path.to_owned(), kind.clone());
            let open: OpenStream = Arc::new(move || read.stream(&capture));
            let description = format!("recording: {}\nnote: {}", description.format, description.notes.join("\nnote: "));
            let t_lidar_imu = if options.use_imu { kind.t_sensor_imu(path)? } else { None };
            return Ok(Self {
                path: path.into(),
                capture: Some(kind),
                open,
                model: None,
                count: None,
                interval_s: None,
                undistorted_sign: None,
                description,
                t_lidar_imu,
                t_first_sensor: Vec::new(),
                log,
            });
        }
        let (files, summary) = summarise(path)?;
        let clouds = choose_clouds(&summary, path, options.cloud_topic.as_deref())?;
        refuse_registered(&summary, path, &clouds)?;
        let further = choose_further_clouds(&summary, path, &clouds, options)?;
        let described = describe_bag(files.clone(), &summary, options)?;
        let (more, mut t_first_sensor): (Vec<String>, Vec<Pose>) = further.into_iter().unzip();
        let topics: Vec<String> = std::iter::once(clouds.clone()).chain(more).collect();
        let packets = PacketTopics::of(&summary, path, &topics, options)?;
        // How many scans packets make is not known.
        let of_topics: Option<Vec<u64>> = topics.iter().map(|name| summary.count(name).filter(|_| packets.sensors.is_empty())).collect();
        let count = of_topics.and_then(|counts| usize::try_from(counts.iter().sum::<u64>()).ok());
        let description =
            format!("recording: {}\nclouds: {}", described.format, topics.join(", ")) + &count.map_or(String::new(), |n| format!(", {n}"));
        let description = packets.notes.iter().fold(description, |said, note| format!("{said}\nnote: {note}"));
        let imu = choose_imu(&summary, &packets, path, &clouds, options)?;
        let description = if imu.remark.is_empty() { description } else { format!("{description}\n{}", imu.remark) };
        let (imu, t_lidar_imu) = imu.topic.map_or((None, None), |(name, pose)| (Some(name), Some(pose)));
        let model = packets.model(&topics).map(Box::new);
        let further = further_frames(&summary, &topics, &packets);
        let first_frame = summary.cloud_topics.get(&clouds).map(|topic| topic.frame.clone()).unwrap_or_default();
        for frame in &further {
            t_first_sensor.push(mounted_beside(&summary, path, &first_frame, frame)?);
        }
        let description =
            further.iter().fold(description, |said, f| format!("{said}\nnote: clouds of {} in {} are of a sensor of their own", f.topic, f.frame));
        let intervals: Vec<Interval> = summary.intervals(&topics).into_iter().chain(further.iter().map(|frame| frame.interval.clone())).collect();
        let interval_s = intervals.first().and_then(Interval::usual);
        let frames = further.into_iter().map(|frame| [frame.topic, frame.frame]).collect();
        let without_stamps = summary.without_stamps(topics.iter().chain(&imu));
        let undistorted_sign = summary.undistorted_sign(&clouds);
        let description =
            super::description::without_stamps(&without_stamps).map_or(description.clone(), |note| format!("{description}\nnote: {note}"));
        let stretches_times = options.point_times == PointTimes::OverInterval;
        let topics = StreamTopics {
            stretches_times,
            clouds: topics,
            frames,
            intervals,
            without_stamps,
            imu,
            packets: packets.sensors,
            ..StreamTopics::default()
        };
        let open: OpenStream = Arc::new(move || Ok(Box::new(BagStream::new(&files, topics.clone())) as Box<dyn MessageStream>));
        Ok(Self { path: path.into(), capture: None, open, model, count, interval_s, undistorted_sign, description, t_lidar_imu, t_first_sensor, log })
    }

    /// Pose of each further sensor in the frame of the first.
    pub(crate) fn t_first_sensor(&self) -> &[Pose] {
        &self.t_first_sensor
    }

    /// What is in it, in a few lines.
    pub(crate) fn description(&self) -> String {
        self.description.clone()
    }

    /// Number of clouds, if known before they are read.
    pub(crate) fn count(&self) -> Option<usize> {
        self.count
    }

    /// The usual time between the clouds of the first sensor in the beginning, seconds, if a sweep can take that long.
    pub(crate) fn interval_s(&self) -> Option<f64> {
        self.interval_s
    }

    /// What speaks for clouds that are undistorted already, although their points have times.
    pub(crate) fn undistorted_sign(&self) -> Option<String> {
        self.undistorted_sign.clone()
    }

    /// The sensor's own tables of beams, if its packets were recorded with them.
    pub(crate) fn sensor(&self) -> Option<BeamModel> {
        self.capture.as_ref().map_or_else(|| self.model.as_deref().cloned(), |capture| capture.model(&self.path))
    }

    /// The clouds from the beginning. A part that cannot be read is an `Err` item.
    pub(crate) fn scans(&self) -> impl Iterator<Item = Result<RecordedScan>> + Send + use<> {
        let (open, log) = (Arc::clone(&self.open), Arc::clone(&self.log));
        let mut player = None;
        let mut mount = self.t_lidar_imu.map(ImuMount::new);
        std::iter::from_fn(move || {
            if player.is_none() {
                match open() {
                    Ok(stream) => player = Some(RawPlayer::new(stream, mount.take(), Arc::clone(&log))),
                    Err(error) => {
                        player = Some(RawPlayer::ended(Arc::clone(&log)));
                        return Some(Err(error));
                    }
                }
            }
            player.as_mut()?.next()
        })
    }

    /// Reads clouds again that [`scans`](Self::scans) delivered.
    pub(crate) fn clouds(&self) -> impl ScanSource + Send + use<> {
        CloudRereader::new(Arc::clone(&self.open), Arc::clone(&self.log))
    }
}
