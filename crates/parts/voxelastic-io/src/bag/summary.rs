//! Summary of a recording: topics and counts from its index, and what its first seconds show.

use super::containers::container::{Index, Topic};
use super::containers::open::open;
use super::messages::topic_role::TopicRole;
use super::stream::{MessageReader, is_static};
use crate::Result;
use crate::motion::{TransformTree, is_map};
use crate::points::undistorted_sign;
use crate::stamped_cloud::Interval;
use std::collections::HashMap;
use std::path::PathBuf;

/// At most this much of the beginning is read, seconds of recording.
const BEGINNING_S: f64 = 5.0;
/// Transforms are read for this long: moving ones are published more often.
const TRANSFORMS_S: f64 = 1.0;
/// At most this much of the beginning is read, bytes of messages.
const BEGINNING_BYTES: usize = 256 << 20;

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TopicSummary {
    /// Such as `/points_raw`.
    pub name: String,
    /// Type as package/Type.
    pub kind: String,
    /// Messages, if the recording has an index or was read through.
    pub messages: Option<u64>,
}

/// What the first messages of a cloud topic show.
#[derive(Clone, Debug, Default)]
pub(super) struct CloudTopic {
    /// Frame of a cloud.
    pub(super) frame: String,
    /// Fields of a cloud.
    pub(super) fields: Vec<String>,
    /// How often they come.
    pub(super) interval: Interval,
    /// Further frames of its clouds, and how often those come: several sensors may publish to one topic.
    more: Vec<(String, Interval)>,
}

impl CloudTopic {
    /// Sensors that publish to one topic at most: a driver that names each cloud anew makes no sensors.
    const MOST_FRAMES: usize = 8;

    /// Notes a cloud in this frame, of this time in seconds.
    fn add(&mut self, frame: String, time: f64) {
        if frame == self.frame {
            self.interval.after(time);
        } else if let Some((_, interval)) = self.more.iter_mut().find(|(other, _)| *other == frame) {
            interval.after(time);
        } else if self.more.len() + 1 < Self::MOST_FRAMES {
            self.more.push((frame, Interval::default()));
            self.more.last_mut().map(|(_, interval)| interval.after(time));
        }
    }
}

/// A further sensor that publishes to the topic of another one.
pub(super) struct FurtherFrame {
    pub(super) topic: String,
    pub(super) frame: String,
    pub(super) interval: Interval,
}

/// What is known about a recording before it is played.
pub(super) struct RecordingSummary {
    pub(super) files: Vec<PathBuf>,
    pub(super) topics: Vec<Topic>,
    /// Messages of each topic, if all files have an index.
    pub(super) counts: Option<Vec<u64>>,
    /// Times of the first and the last message, seconds, under the same condition.
    pub(super) times: Option<[f64; 2]>,
    pub(super) cloud_topics: HashMap<String, CloudTopic>,
    /// Frames of the topics of inertial measurement units.
    pub(super) imu_frames: HashMap<String, String>,
    /// The frames of maps that poses are in, by their topics.
    pub(super) pose_frames: HashMap<String, String>,
    /// Messages with a header of each topic at the beginning, and how many of them have a time stamp.
    stamps: HashMap<String, [usize; 2]>,
    /// The transforms at the beginning.
    pub(super) tree: TransformTree,
    /// Remarks about the files.
    pub(super) notes: Vec<String>,
}

impl RecordingSummary {
    /// Reads the indices and the beginning.
    ///
    /// # Errors
    /// Those of opening the files.
    pub(super) fn of(files: &[PathBuf]) -> Result<Self> {
        let mut summary = Self { files: files.to_vec(), counts: Some(Vec::new()), ..Self::of_topics(Vec::new()) };
        for file in files {
            let container = match open(file) {
                Ok(container) => container,
                // A part that is not a recording is reported when it is played; if it is the only file, it cannot be opened.
                Err(error) if files.len() > 1 => {
                    summary.counts = None;
                    summary.notes.push(error.to_string());
                    continue;
                }
                Err(error) => return Err(error),
            };
            let index = container.index();
            let has_index = index.is_some();
            summary.add_index(container.topics(), index);
            if !has_index {
                summary
                    .notes
                    .push(format!("{} has no index, probably because the recording was not closed: it is read as far as it goes", file.display()));
            }
        }
        summary.read_beginning(files);
        Ok(summary)
    }

    /// Of topics whose messages have not been seen.
    pub(super) fn of_topics(topics: Vec<Topic>) -> Self {
        Self {
            files: Vec::new(),
            topics,
            counts: None,
            times: None,
            cloud_topics: HashMap::new(),
            imu_frames: HashMap::new(),
            pose_frames: HashMap::new(),
            stamps: HashMap::new(),
            tree: TransformTree::default(),
            notes: Vec::new(),
        }
    }

    fn add_index(&mut self, topics: &[Topic], index: Option<Index>) {
        let indices: Vec<usize> = topics.iter().map(|t| self.topic_index(t)).collect();
        let (Some(counts), Some(index)) = (&mut self.counts, index) else {
            self.counts = None;
            return;
        };
        counts.resize(self.topics.len(), 0);
        for (index, count) in indices.iter().zip(&index.counts) {
            counts[*index] += count;
        }
        if let Some((first, last)) = index.times_ns.map(|(a, b)| (a as f64 * 1e-9, b as f64 * 1e-9)) {
            self.times = Some(self.times.map_or([first, last], |[a, b]| [a.min(first), b.max(last)]));
        }
    }

    fn topic_index(&mut self, topic: &Topic) -> usize {
        let known = self.topics.iter().position(|t| t.name == topic.name && t.kind == topic.kind);
        known.unwrap_or_else(|| {
            self.topics.push(topic.clone());
            self.topics.len() - 1
        })
    }

    /// Reads the first messages of the topics that are used.
    fn read_beginning(&mut self, files: &[PathBuf]) {
        let mut messages = MessageReader::new(files);
        let (mut first, mut bytes) = (None, 0);
        // Damaged parts are reported when the recording is played.
        while let Some(message) = messages.next(&|_, _| true) {
            let Ok(message) = message else { continue };
            let time = message.message.time();
            bytes += message.message.data.len();
            let elapsed = time - *first.get_or_insert(time);
            if elapsed > BEGINNING_S || bytes > BEGINNING_BYTES || self.is_complete_after(elapsed) {
                break;
            }
            let index = self.topic_index(&message.topic);
            if let Some(counts) = &mut self.counts {
                counts.resize(self.topics.len().max(index + 1), 0);
            }
            let decoder = message.decoder();
            if matches!(message.role, TopicRole::PointCloud2 | TopicRole::Livox | TopicRole::Odometry | TopicRole::PoseStamped | TopicRole::Imu)
                && let Ok(header) = decoder.header()
            {
                let [all, stamped] = self.stamps.entry(message.topic.name.clone()).or_default();
                (*all, *stamped) = (*all + 1, *stamped + usize::from(header.time != 0.0));
            }
            let cloud_topic = match message.role {
                TopicRole::Transforms => {
                    let is_fixed = is_static(&message.topic.name);
                    for p in decoder.poses(message.role).unwrap_or_default() {
                        self.tree.add(&p.parent, &p.child, p.time, p.t_parent_child, is_fixed);
                    }
                    None
                }
                role if role.is_cloud() => decoder.header().ok().map(|header| {
                    let fields = decoder.cloud_fields(role).unwrap_or_default();
                    (CloudTopic { frame: header.frame.clone(), fields, ..CloudTopic::default() }, header)
                }),
                TopicRole::Odometry | TopicRole::PoseStamped => {
                    for pose in decoder.poses(message.role).unwrap_or_default().into_iter().filter(|pose| is_map(&pose.parent, &pose.child)) {
                        self.pose_frames.entry(message.topic.name.clone()).or_insert(pose.parent);
                    }
                    None
                }
                TopicRole::Imu => {
                    if let Ok(header) = decoder.header() {
                        self.imu_frames.entry(message.topic.name.clone()).or_insert(header.frame);
                    }
                    None
                }
                _ => None,
            };
            if let Some((cloud_topic, header)) = cloud_topic {
                self.cloud_topics.entry(message.topic.name.clone()).or_insert(cloud_topic).add(header.frame, header.time);
            }
        }
    }

    /// Whether reading on would show nothing new: each cloud topic was seen twice, and transforms were read long enough. Without an index more
    /// topics may appear.
    fn is_complete_after(&self, elapsed: f64) -> bool {
        let clouds = self.of_role(TopicRole::is_cloud);
        let transforms = self.of_role(|role| role == TopicRole::Transforms);
        let units = self.of_role(|role| role == TopicRole::Imu);
        self.counts.is_some()
            && units.iter().all(|(name, _)| self.imu_frames.contains_key(name))
            && clouds
                .iter()
                .all(|(name, _)| self.cloud_topics.get(name).is_some_and(|topic| topic.interval.is_known() || self.count(name) == Some(1)))
            && (transforms.is_empty() || elapsed > TRANSFORMS_S)
    }

    /// How often the clouds of topics come.
    pub(super) fn intervals(&self, clouds: &[String]) -> Vec<Interval> {
        clouds.iter().map(|name| self.cloud_topics.get(name).map(|topic| topic.interval.before_first()).unwrap_or_default()).collect()
    }

    /// The sensors that publish to these topics beside the first of each.
    pub(super) fn further_frames(&self, clouds: &[String]) -> Vec<FurtherFrame> {
        let of_topic = |topic: &String| {
            let known = self.cloud_topics.get(topic)?;
            Some(known.more.iter().map(|(frame, interval)| (topic.clone(), frame.clone(), interval.before_first())).collect::<Vec<_>>())
        };
        let all = clouds.iter().filter_map(of_topic).flatten();
        all.map(|(topic, frame, interval)| FurtherFrame { topic, frame, interval }).collect()
    }

    /// Those of these topics whose messages have time stamps of zero.
    pub(super) fn without_stamps<'a>(&self, topics: impl IntoIterator<Item = &'a String>) -> Vec<String> {
        let has_none = |name: &&String| self.stamps.get(*name).is_some_and(|[all, stamped]| *all > 1 && *stamped == 0);
        topics.into_iter().filter(has_none).cloned().collect()
    }

    /// What speaks for clouds of a topic that are undistorted already, although their points have times.
    pub(super) fn undistorted_sign(&self, topic: &str) -> Option<String> {
        undistorted_sign(topic, &self.cloud_topics.get(topic)?.fields)
    }

    /// A topic whose poses are in this frame: clouds of the frame were moved into it by an odometry.
    pub(super) fn registered_by(&self, frame: &str) -> Option<&str> {
        let topics = self.pose_frames.iter().filter(|(_, of_poses)| *of_poses == frame);
        topics.map(|(topic, _)| topic.as_str()).min()
    }

    /// Number of messages of a topic, if it is known.
    pub(super) fn count(&self, topic: &str) -> Option<u64> {
        let counts = self.counts.as_ref()?;
        Some(self.topics.iter().zip(counts).filter(|(t, _)| t.name == topic).map(|(_, n)| n).sum())
    }

    /// Topics of a role that have messages, or may have.
    pub(super) fn of_role(&self, has: impl Fn(TopicRole) -> bool) -> Vec<(String, TopicRole)> {
        let with_role = self.topics.iter().filter_map(|t| TopicRole::of(t).filter(|r| has(*r)).map(|r| (t.name.clone(), r)));
        with_role.filter(|(name, _)| self.count(name) != Some(0)).collect()
    }

    /// The topics by name.
    pub(super) fn topic_summaries(&self) -> Vec<TopicSummary> {
        let summary = |(k, t): (usize, &Topic)| TopicSummary {
            name: t.name.clone(),
            kind: t.kind.clone(),
            messages: self.counts.as_ref().and_then(|c| c.get(k)).copied(),
        };
        let mut all: Vec<TopicSummary> = self.topics.iter().enumerate().map(summary).collect();
        all.sort_by(|a, b| a.name.cmp(&b.name));
        all
    }
}

/// Counts the messages of a recording without an index by reading it all; also gives the time of the first and the last, seconds.
pub(super) fn count_messages(files: &[PathBuf]) -> (HashMap<String, u64>, Option<[f64; 2]>) {
    let (mut counts, mut times): (HashMap<String, u64>, Option<[f64; 2]>) = (HashMap::new(), None);
    for file in files {
        let Ok(mut container) = open(file) else { continue };
        while let Some(message) = container.next(&|_| true) {
            let Ok(message) = message else { continue };
            let time = message.time();
            times = Some(times.map_or([time; 2], |[a, b]| [a.min(time), b.max(time)]));
            *counts.entry(container.topics()[message.topic].name.clone()).or_default() += 1;
        }
    }
    (counts, times)
}
