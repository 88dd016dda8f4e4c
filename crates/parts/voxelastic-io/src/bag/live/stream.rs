//! Messages that come from a middleware as a stream.

use super::super::containers::container::{Encoding, Message, Topic};
use super::super::messages::topic_role::TopicRole;
use super::super::stream::{SensorMessages, TopicMessage};
use super::{LiveFrames, LiveMessages, LiveTopics};
use crate::Result;
use crate::motion::ImuMount;
use crate::playback::{MessageStream, SensorMessage};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// How long a call waits for a message.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// A message whose stamp is this far from the clock of a simulation, seconds, may be of another run of it.
const LARGEST_DISORDER_S: f64 = 1.0;

/// The clock of a simulation comes in order: if it goes back by this much, seconds, the simulation was started again.
const LARGEST_TICK_BACK_S: f64 = 0.1;

/// A stream of the messages that a middleware delivers. Its time is that of their coming, so that scans do not wait for ever for what was lost; with a clock, that
/// of the simulation, which may be slow.
pub(super) struct LiveStream {
    messages: LiveMessages,
    topics: Vec<(Topic, TopicRole)>,
    sensor: SensorMessages,
    frames: LiveFrames,
    imu: Option<ImuMount>,
    path: Arc<Path>,
    start: Instant,
    clock: Option<Clock>,
}

/// The clock of a simulation.
struct Clock {
    /// Position of its topic.
    topic: usize,
    now: Option<f64>,
    /// Time that has passed, without jumps.
    elapsed: f64,
    /// When it was before the last jump back: messages up to then may still be on their way.
    before: Option<f64>,
}

impl Clock {
    /// Takes a message; by how much the clock went back, if it did.
    fn tick(&mut self, message: &[u8]) -> Option<f64> {
        let number = |at: usize| Some(u32::from_le_bytes(*message.get(at..)?.first_chunk()?));
        // After the header, seconds and nanoseconds.
        let time = f64::from(number(4)?) + 1e-9 * f64::from(number(8)?);
        let step = self.now.map_or(0.0, |now| time - now);
        if step < 0.0 && step > -LARGEST_TICK_BACK_S {
            return None;
        }
        let back = self.now.replace(time).filter(|_| step < 0.0);
        self.before = back.or(self.before);
        self.elapsed += step.max(0.0);
        back.map(|_| -step)
    }

    /// Whether a message with this stamp is from before the simulation was started again.
    fn is_of_before(&self, stamp: f64) -> bool {
        let is_ahead = |by: f64| self.now.is_some_and(|now| stamp > now + by);
        self.before.is_some_and(|before| stamp <= before + LARGEST_DISORDER_S) && is_ahead(LARGEST_DISORDER_S)
    }
}

impl LiveStream {
    pub(super) fn new(topics: LiveTopics, messages: LiveMessages, frames: LiveFrames) -> Self {
        let known = topics.subscriptions().iter().filter_map(|topic| {
            // That transforms are fixed is told by the name, which may be another one here.
            let name = if topic.is_latched { "/tf_static" } else { topic.name.as_str() };
            let topic = Topic::new(name.to_owned(), &topic.kind, Encoding::Cdr);
            TopicRole::of(&topic).map(|role| (topic, role))
        });
        let (topics_of_roles, path) = (known.collect(), topics.origin.as_path().into());
        let clock = topics.clock().map(|topic| Clock { topic, now: None, elapsed: 0.0, before: None });
        Self { messages, topics: topics_of_roles, sensor: SensorMessages::new(topics.stream), frames, imu: None, path, start: Instant::now(), clock }
    }

    /// A message of the clock.
    fn tick(&mut self, data: &[u8]) -> SensorMessage {
        let Some(clock) = &mut self.clock else { return SensorMessage::Other };
        let back = clock.tick(data);
        clock.now.into_iter().for_each(|now| self.frames.set_clock(now));
        let Some(back) = back else { return SensorMessage::Other };
        self.frames.forget_moving();
        tracing::warn!("the simulation was started again: its clock went back by {back:.1} s; the poses that came before are not used any more");
        SensorMessage::ClockJump
    }

    fn decode(&mut self, topic: usize, data: Vec<u8>) -> Result<SensorMessage> {
        if self.clock.as_ref().is_some_and(|clock| clock.topic == topic) {
            return Ok(self.tick(&data));
        }
        let Some((topic, role)) = self.topics.get(topic).cloned() else { return Ok(SensorMessage::Other) };
        let time_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX));
        let message = Message { topic: 0, time_ns, at: 0, data };
        let message = TopicMessage { path: Arc::clone(&self.path), topic, role, message };
        let imu_frame = if role == TopicRole::Imu { Some(message.decoder().header()?.frame) } else { None };
        let decoded = self.sensor.decode(message)?;
        if self.is_of_before(&decoded) || self.is_published_here(&decoded) {
            return Ok(SensorMessage::Other);
        }
        self.note_frames(&decoded);
        Ok(match (decoded, imu_frame) {
            (SensorMessage::Imu(sample), Some(frame)) => {
                self.imu = self.imu.take().or_else(|| self.frames.beside_lidar(&frame).map(ImuMount::new));
                self.imu.as_mut().map_or(SensorMessage::Other, |mount| SensorMessage::Imu(mount.at_lidar(sample)))
            }
            (decoded, _) => decoded,
        })
    }

    /// Whether a message is from before the simulation was started again.
    fn is_of_before(&self, message: &SensorMessage) -> bool {
        stamp_of(message).zip(self.clock.as_ref()).is_some_and(|(stamp, clock)| clock.is_of_before(stamp))
    }

    /// Whether a message is a transform of a frame that is placed here: it comes back from the network, or from somebody who places it, too.
    fn is_published_here(&self, message: &SensorMessage) -> bool {
        let SensorMessage::Transform { time, parent, child, is_fixed: false, .. } = message else { return false };
        self.frames.is_published_here([parent, child], *time)
    }

    /// Notes the frames that a message names.
    fn note_frames(&self, message: &SensorMessage) {
        match message {
            SensorMessage::Cloud(cloud) if cloud.sensor == 0 => self.frames.set_lidar(&cloud.frame),
            SensorMessage::ClockJump => self.frames.forget_moving(),
            SensorMessage::Pose { parent, child, .. } => self.frames.set_poses(parent, child),
            SensorMessage::Transform { parent, child, pose, is_fixed, time } => self.frames.add_transform([parent, child], *time, *pose, *is_fixed),
            _ => {}
        }
    }
}

impl MessageStream for LiveStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.sensor.pending() {
            if self.is_of_before(&message) || self.is_published_here(&message) {
                return Some(Ok(SensorMessage::Other));
            }
            self.note_frames(&message);
            return Some(Ok(message));
        }
        match self.messages.recv_timeout(POLL_INTERVAL) {
            Ok((topic, data)) => Some(self.decode(topic, data)),
            Err(RecvTimeoutError::Timeout) => Some(Ok(SensorMessage::Other)),
            Err(RecvTimeoutError::Disconnected) => None,
        }
    }

    fn now(&self) -> f64 {
        self.clock.as_ref().map_or_else(|| self.start.elapsed().as_secs_f64(), |clock| clock.elapsed)
    }
}

/// The time stamp of a message; none of what is always true.
fn stamp_of(message: &SensorMessage) -> Option<f64> {
    match message {
        SensorMessage::Cloud(cloud) => Some(cloud.time),
        SensorMessage::Pose { time, .. } | SensorMessage::Transform { time, is_fixed: false, .. } => Some(*time),
        SensorMessage::Imu(sample) => Some(sample.time),
        _ => None,
    }
}
