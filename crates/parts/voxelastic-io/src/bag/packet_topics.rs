//! The sensors whose packets are in topics of a recording.

use super::containers::container::Topic;
use super::messages::packets::PacketLayout;
use super::messages::topic_role::TopicRole;
use super::stream::MessageReader;
use super::summary::RecordingSummary;
use crate::capture::{PacketSensor, find_angles};
use crate::ouster::{SensorMetadata, find_metadata};
use crate::{Error, OpenOptions, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::sensor::BeamModel;

/// So many packets of a topic are looked at: more than a second of most sensors. Of an Ouster with metadata, fewer.
const PACKETS: usize = 2000;
const PACKETS_OF_OUSTER: usize = 64;

/// The sensors of the chosen topics that hold packets.
#[derive(Clone, Debug, Default)]
pub(super) struct PacketTopics {
    /// By topic.
    pub(super) sensors: BTreeMap<String, PacketSensor>,
    /// What was found, in words.
    pub(super) notes: Vec<String>,
}

impl PacketTopics {
    /// Recognises the sensors of those topics of `clouds` that hold packets.
    ///
    /// # Errors
    /// [`Error::Dataset`] if packets cannot be read; those of files with metadata or angles.
    pub(super) fn of(summary: &RecordingSummary, path: &Path, clouds: &[String], options: &OpenOptions) -> Result<Self> {
        let of_packets = |name: &String| summary.topics.iter().find(|t| t.name == *name && TopicRole::of(t) == Some(TopicRole::Packets));
        let topics: Vec<&Topic> = clouds.iter().filter_map(of_packets).collect();
        let is_one = topics.len() == 1;
        if let (Some(file), [first, second, ..]) = (&options.metadata, topics.as_slice()) {
            let problem = format!("{} is of one sensor, but there are packets of {} and {}", file.display(), first.name, second.name);
            return Err(Error::dataset(path, problem, "do without --metadata, or map one of them (--cloud-topic)"));
        }
        let mut all = Self::default();
        for topic in topics {
            let files = Beside { path, first: summary.files.first().filter(|_| is_one), given: options.metadata.as_deref() };
            let (sensor, notes) = Beginning::of(&summary.files, topic)?.sensor(topic, &files)?;
            all.sensors.insert(topic.name.clone(), sensor);
            all.notes.extend(notes.into_iter().map(|note| if is_one { note } else { format!("{}: {note}", topic.name) }));
        }
        Ok(all)
    }

    /// The sensor's own tables of beams, if it is the only one.
    pub(super) fn model(&self, clouds: &[String]) -> Option<BeamModel> {
        let [one] = clouds else { return None };
        self.ouster(one)?.model().ok()
    }

    /// The topic with packets of the inertial unit in the sensor of a topic, and the pose of the unit in its frame.
    pub(super) fn imu(&self, summary: &RecordingSummary, clouds: &str, options: &OpenOptions) -> Option<(String, Pose)> {
        let metadata = self.ouster(clouds).filter(|_| options.use_imu)?;
        let plain = |name: &str| name.trim_start_matches('/').to_owned();
        let is_asked = |name: &str| options.imu_topic.as_ref().is_none_or(|asked| plain(asked) == plain(name));
        let units = summary.of_role(|role| role == TopicRole::ImuPackets);
        let (name, _) = units.into_iter().find(|(name, _)| space(name) == space(clouds) && is_asked(name))?;
        Some((name, metadata.t_sensor_imu))
    }

    fn ouster(&self, topic: &str) -> Option<&SensorMetadata> {
        if let PacketSensor::Ouster(metadata) = self.sensors.get(topic)? { Some(metadata) } else { None }
    }
}

/// What a topic's name begins with.
fn space(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(space, _)| space)
}

/// Where files about a sensor may be.
struct Beside<'a> {
    path: &'a Path,
    /// The first file of the recording, if what is beside it is of this sensor.
    first: Option<&'a PathBuf>,
    /// What the user names.
    given: Option<&'a Path>,
}

impl Beside<'_> {
    fn find(&self, find: impl Fn(&Path) -> Option<PathBuf>) -> Option<PathBuf> {
        let first = self.first?;
        find(self.path).or_else(|| find(first))
    }
}

/// The first packets of a topic, with what its sensor says about itself.
#[derive(Default)]
struct Beginning {
    packets: Vec<Vec<u8>>,
    /// A topic with metadata, and the first of them.
    metadata: Option<(String, String)>,
}

impl Beginning {
    /// # Errors
    /// If none of the messages has any packets, why.
    fn of(files: &[PathBuf], topic: &Topic) -> Result<Self> {
        let mut messages = MessageReader::new(files);
        let is_about = |other: &Topic| match PacketLayout::of(&other.kind) {
            Some(_) => other.name.starts_with(&topic.name),
            None => PacketLayout::of(&topic.kind) == Some(PacketLayout::Bare) && space(&other.name) == space(&topic.name),
        };
        let (mut found, mut problem) = (Self::default(), None);
        let is_wanted = |other: &Topic, role: TopicRole| other.name == topic.name || (role == TopicRole::SensorInfo && is_about(other));
        // What is damaged is reported when the recording is played.
        while let Some(message) = messages.next(&is_wanted) {
            let Ok(message) = message else { continue };
            let decoder = message.decoder();
            if PacketLayout::of(&message.topic.kind).is_some() {
                match decoder.packets() {
                    Ok(packets) => found.packets.extend(packets.into_iter().map(|(_, packet)| packet.to_vec())),
                    Err(error) => problem = problem.or(Some(error)),
                }
            } else if let (None, Ok(text)) = (&found.metadata, decoder.text()) {
                found.metadata = Some((message.topic.name.clone(), text));
            }
            if found.packets.len() >= if found.metadata.is_some() { PACKETS_OF_OUSTER } else { PACKETS } {
                break;
            }
        }
        problem.filter(|_| found.packets.is_empty()).map_or(Ok(found), Err)
    }

    /// The sensor, and what was found, in words.
    fn sensor(self, topic: &Topic, files: &Beside<'_>) -> Result<(PacketSensor, Vec<String>)> {
        let words = format!("topic {} ({})", topic.name, topic.kind);
        if PacketLayout::of(&topic.kind) != Some(PacketLayout::Bare) {
            return PacketSensor::recognise(self.packets, files.path, &words, files.given, || files.find(find_angles));
        }
        let file = files.given.map(Path::to_owned);
        let file = if self.metadata.is_none() { file.or_else(|| files.find(|path| find_metadata(path).ok())) } else { file };
        let (metadata, source) = match (file, &self.metadata) {
            (Some(file), _) => (SensorMetadata::read(&file)?, file.display().to_string()),
            (None, Some((name, text))) => (SensorMetadata::parse(text.as_bytes(), &files.path.join(name.trim_start_matches('/')))?, name.clone()),
            (None, None) => {
                let problem = format!("{words} has packets of an Ouster sensor, but no topic beside it has the sensor's metadata");
                return Err(Error::dataset(files.path, problem, "give the sensor's .json with --metadata, or put it beside the recording"));
            }
        };
        let sensor = PacketSensor::Ouster(Box::new(metadata));
        let mut scans = sensor.scans()?;
        if !self.packets.iter().any(|packet| scans.add(packet, 0.0)) {
            let problem = format!("{words}: none of the first {} packets is of the sensor that {source} describes", self.packets.len());
            return Err(Error::dataset(files.path, problem, "give its own .json with --metadata"));
        }
        Ok((sensor, vec![format!("the sensor is described by {source}")]))
    }
}
