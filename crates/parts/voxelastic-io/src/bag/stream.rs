//! The messages of a recording as clouds, poses and transforms, one file after the other.

use super::containers::container::{Container, Message, Topic};
use super::containers::open::open;
use super::messages::decoder::MessageDecoder;
use super::messages::topic_role::TopicRole;
use crate::Result;
use crate::capture::{PacketScans, PacketSensor, message as cloud_message};
use crate::motion::PoseTrack;
use crate::playback::{CloudMessage, MessageStream, SensorMessage};
use crate::points::{is_time, undistorted_sign};
use crate::stamped_cloud::{Interval, StampedCloud, SweepTime};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Once};
use voxelastic::motion::ImuSample;

/// A message with its topic and file.
#[derive(Debug)]
pub(super) struct TopicMessage {
    pub(super) path: Arc<Path>,
    pub(super) topic: Topic,
    pub(super) role: TopicRole,
    pub(super) message: Message,
}

impl TopicMessage {
    pub(super) fn decoder(&self) -> MessageDecoder<'_> {
        MessageDecoder { path: &self.path, topic: &self.topic, message: &self.message }
    }

    fn cloud(&self) -> Result<StampedCloud> {
        self.decoder().cloud(self.role)
    }
}

/// Reads the messages of all files of a recording.
pub(super) struct MessageReader {
    files: VecDeque<PathBuf>,
    current: Option<(Arc<Path>, Box<dyn Container>)>,
}

impl MessageReader {
    pub(super) fn new(files: &[PathBuf]) -> Self {
        Self { files: files.iter().cloned().collect(), current: None }
    }

    /// The next message of a wanted topic and role.
    pub(super) fn next(&mut self, wanted: &dyn Fn(&Topic, TopicRole) -> bool) -> Option<Result<TopicMessage>> {
        loop {
            if let Some((path, container)) = &mut self.current {
                let is_wanted = |t: &Topic| TopicRole::of(t).is_some_and(|role| wanted(t, role));
                match container.next(&is_wanted) {
                    Some(Ok(message)) => {
                        let topic = container.topics()[message.topic].clone();
                        let Some(role) = TopicRole::of(&topic) else { continue };
                        return Some(Ok(TopicMessage { path: Arc::clone(path), topic, role, message }));
                    }
                    Some(Err(error)) => return Some(Err(error)),
                    None => self.current = None,
                }
            }
            let file = self.files.pop_front()?;
            match open(&file) {
                Ok(container) => self.current = Some((file.into(), container)),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The topics that a stream reads, besides transforms.
#[derive(Clone, Debug, Default)]
pub(super) struct StreamTopics {
    /// Those of the clouds, one for each sensor.
    pub(super) clouds: Vec<String>,
    pub(super) poses: Option<String>,
    /// Corrected poses.
    pub(super) corrections: Option<String>,
    pub(super) imu: Option<String>,
    /// The sensors of the clouds that are made of packets.
    pub(super) packets: BTreeMap<String, PacketSensor>,
    /// How often clouds of each sensor come, as far as the beginning shows it.
    pub(super) intervals: Vec<Interval>,
    /// Further sensors that publish to a topic of the clouds: the topic, and the frame of their clouds.
    pub(super) frames: Vec<[String; 2]>,
    /// Whether nobody looks at some of the clouds first: what is doubtful about the times of their points is said as they come.
    pub(super) are_unexamined: bool,
    /// Whether times of points are stretched over the interval between clouds.
    pub(super) stretches_times: bool,
    /// Topics whose messages have time stamps of zero: the times at which they were recorded are taken.
    pub(super) without_stamps: Vec<String>,
}

impl StreamTopics {
    /// Whether the messages of a topic are used.
    pub(super) fn has(&self, topic: &Topic, role: TopicRole) -> bool {
        let is = |name: &Option<String>| Some(&topic.name) == name.as_ref();
        match role {
            TopicRole::Transforms => true,
            TopicRole::Imu | TopicRole::ImuPackets => is(&self.imu),
            role if role.is_cloud() => self.clouds.contains(&topic.name),
            _ => is(&self.poses) || is(&self.corrections),
        }
    }

    /// The time of a message by its stamp, or when it was recorded.
    fn time(&self, message: &TopicMessage, stamp: f64) -> f64 {
        if self.without_stamps.contains(&message.topic.name) { message.message.time() } else { stamp }
    }

    /// Which sensor the clouds of a topic in this frame are of.
    fn sensor(&self, topic: &str, frame: &str) -> u16 {
        let further = self.frames.iter().position(|[name, further]| name == topic && further == frame);
        let sensor = further.map_or_else(|| self.clouds.iter().position(|name| name == topic), |k| Some(self.clouds.len() + k));
        sensor.unwrap_or(0) as u16
    }
}

/// The scans of a topic with packets.
struct TopicScans {
    scans: PacketScans,
    sensor: u16,
    topic: String,
    frame: String,
    path: Arc<Path>,
}

impl TopicScans {
    fn message(&self, scan: StampedCloud) -> SensorMessage {
        let time = scan.stamp.unwrap_or(0.0);
        SensorMessage::Cloud(CloudMessage { sensor: self.sensor, ..cloud_message(scan, time, &self.frame, &self.path) })
    }
}

/// Messages of topics as clouds, poses and transforms.
pub(super) struct SensorMessages {
    topics: StreamTopics,
    /// What is left of a message that holds several poses or scans.
    pending: VecDeque<SensorMessage>,
    /// What makes scans of the packets of each sensor.
    packets: BTreeMap<u16, TopicScans>,
    /// How often clouds of each sensor come.
    intervals: BTreeMap<u16, Interval>,
    /// The frame of the first cloud of each sensor, and whether it was said that others came.
    frames: BTreeMap<u16, (String, bool)>,
}

impl SensorMessages {
    pub(super) fn new(topics: StreamTopics) -> Self {
        let intervals = (0..).zip(topics.intervals.iter().cloned()).collect();
        Self { topics, pending: VecDeque::new(), packets: BTreeMap::new(), intervals, frames: BTreeMap::new() }
    }

    pub(super) fn topics(&self) -> &StreamTopics {
        &self.topics
    }

    /// What is left of the last message.
    pub(super) fn pending(&mut self) -> Option<SensorMessage> {
        self.pending.pop_front()
    }

    /// Says it, once for each sensor, if its clouds come in several frames: they would be those of several sensors.
    fn check_frame(&mut self, sensor: u16, topic: &str, frame: &str) {
        let (first, is_said) = self.frames.entry(sensor).or_insert_with(|| (frame.to_owned(), false));
        if first != frame && !std::mem::replace(is_said, true) {
            tracing::warn!(
                "clouds of {topic} come in several frames ({first}, {frame}) and are taken for those of one sensor: with poses each is placed by its frame, without poses the map is wrong; have each sensor publish to a topic of its own"
            );
        }
    }

    /// Takes packets, and the scans that they complete.
    fn add_packets(&mut self, message: &TopicMessage) -> Result<SensorMessage> {
        let decoder = message.decoder();
        // An inertial unit is in the first sensor.
        let of_unit = self.topics.clouds.first().filter(|_| message.role == TopicRole::ImuPackets);
        let topic = of_unit.unwrap_or(&message.topic.name);
        let Some(source) = self.topics.packets.get(topic) else { return Ok(SensorMessage::Other) };
        let made = match self.packets.entry(self.topics.sensor(topic, "")) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let (sensor, frame, path) = (*new.key(), decoder.header()?.frame, Arc::clone(&message.path));
                new.insert(TopicScans { scans: source.scans()?, sensor, topic: topic.clone(), frame, path })
            }
        };
        for (came, packet) in decoder.packets()? {
            made.scans.add(packet, came);
        }
        self.pending.extend(made.scans.take_imu().into_iter().map(SensorMessage::Imu));
        while let Some(scan) = made.scans.take_scan() {
            self.pending.push_back(made.message(scan));
        }
        Ok(self.pending().unwrap_or(SensorMessage::Other))
    }

    /// What is left at the end of a recording; says which packets could not be used.
    fn finish(&mut self) -> Option<SensorMessage> {
        for (_, mut made) in std::mem::take(&mut self.packets) {
            let last = made.scans.take_unfinished();
            self.pending.extend(last.map(|scan| made.message(scan)));
            if let Some(said) = made.scans.losses() {
                tracing::warn!("{}: {}: {said}", made.path.display(), made.topic);
            }
        }
        self.pending()
    }

    /// Decodes a message; clouds are decoded later.
    pub(super) fn decode(&mut self, message: TopicMessage) -> Result<SensorMessage> {
        if matches!(message.role, TopicRole::Packets | TopicRole::ImuPackets) {
            return self.add_packets(&message);
        }
        let decoder = message.decoder();
        if message.role.is_cloud() {
            let header = decoder.header()?;
            // What is wrong with the rest of it is reported when it is decoded.
            let fields = decoder.cloud_fields(message.role);
            let sign = fields.as_ref().ok().filter(|_| self.topics.are_unexamined).and_then(|fields| undistorted_sign(&message.topic.name, fields));
            let has_times = sign.is_none() && fields.map_or(true, |fields| fields.iter().any(|name| is_time(name)));
            let time = self.topics.time(&message, header.time);
            let bytes = message.message.data.len();
            let sensor = self.topics.sensor(&message.topic.name, &header.frame);
            self.check_frame(sensor, &message.topic.name, &header.frame);
            let intervals = self.intervals.entry(sensor).or_default();
            let interval_s = intervals.after(time);
            let watched = intervals.settled().filter(|_| self.topics.are_unexamined);
            let decode = Box::new(move || {
                let mut cloud = message.cloud()?;
                if let Some(sign) = sign {
                    tell_undistorted(&sign);
                    cloud.cloud.time = None;
                }
                watched.iter().for_each(|interval_s| cloud.tell_misfit(*interval_s));
                Ok(cloud)
            });
            let sweep = SweepTime { interval_s, is_stretched: self.topics.stretches_times };
            return Ok(SensorMessage::Cloud(CloudMessage { time, frame: header.frame, sensor, sweep, has_times, bytes, decode }));
        }
        if message.role == TopicRole::Imu {
            return decoder.imu().map(|sample| SensorMessage::Imu(ImuSample { time: self.topics.time(&message, sample.time), ..sample }));
        }
        let poses = decoder.poses(message.role)?;
        if Some(&message.topic.name) == self.topics.corrections.as_ref() {
            let mut track = PoseTrack::default();
            poses.into_iter().for_each(|p| track.add(p.time, p.t_parent_child));
            return Ok(SensorMessage::Corrected(track));
        }
        let is_fixed = is_static(&message.topic.name);
        let last = poses.len().saturating_sub(1);
        for (k, p) in poses.into_iter().enumerate() {
            self.pending.push_back(match message.role {
                TopicRole::Transforms => {
                    SensorMessage::Transform { time: p.time, parent: p.parent, child: p.child, pose: p.t_parent_child, is_fixed }
                }
                _ => SensorMessage::Pose {
                    time: self.topics.time(&message, p.time),
                    parent: p.parent,
                    child: p.child,
                    pose: p.t_parent_child,
                    is_last: k == last,
                },
            });
        }
        Ok(self.pending().unwrap_or(SensorMessage::Other))
    }
}

/// The message stream of a bag.
pub(super) struct BagStream {
    files: MessageReader,
    messages: SensorMessages,
    now: f64,
}

impl BagStream {
    pub(super) fn new(files: &[PathBuf], topics: StreamTopics) -> Self {
        Self { files: MessageReader::new(files), messages: SensorMessages::new(topics), now: 0.0 }
    }
}

/// Says once why clouds whose points have times are not undistorted.
fn tell_undistorted(sign: &str) {
    static SAID: Once = Once::new();
    SAID.call_once(|| tracing::warn!("{sign}: clouds are taken to be undistorted already; --point-times given takes the times as they are"));
}

/// Whether the transforms of a topic hold at all times.
pub(super) fn is_static(topic: &str) -> bool {
    topic.rsplit('/').next() == Some("tf_static")
}

impl MessageStream for BagStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.messages.pending() {
            return Some(Ok(message));
        }
        let topics = self.messages.topics();
        match self.files.next(&|topic, role| topics.has(topic, role)) {
            Some(Ok(message)) => {
                self.now = message.message.time();
                Some(self.messages.decode(message))
            }
            Some(Err(error)) => Some(Err(error)),
            None => self.messages.finish().map(Ok),
        }
    }

    fn now(&self) -> f64 {
        self.now
    }
}
