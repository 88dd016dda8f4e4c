//! The messages of a recording as clouds, poses and transforms, one file after the other.

use super::container::{Container, Message, Topic};
use super::decoder::MessageDecoder;
use super::open::open;
use super::topic_role::TopicRole;
use crate::Result;
use crate::playback::{CloudMessage, MessageStream, SensorMessage};
use crate::stamped_cloud::StampedCloud;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
#[derive(Clone, Debug)]
pub(super) struct StreamTopics {
    pub(super) clouds: String,
    pub(super) poses: Option<String>,
    pub(super) imu: Option<String>,
}

/// The message stream of a bag.
pub(super) struct BagStream {
    messages: MessageReader,
    topics: StreamTopics,
    /// The remaining poses of a message that holds several.
    pending: VecDeque<SensorMessage>,
    now: f64,
}

impl BagStream {
    pub(super) fn new(files: &[PathBuf], topics: StreamTopics) -> Self {
        Self { messages: MessageReader::new(files), topics, pending: VecDeque::new(), now: 0.0 }
    }

    fn decode(&mut self, message: TopicMessage) -> Result<SensorMessage> {
        self.now = message.message.time_ns as f64 * 1e-9;
        if message.role.is_cloud() {
            let header = message.decoder().header()?;
            let bytes = message.message.data.len();
            let decode = Box::new(move || message.cloud());
            return Ok(SensorMessage::Cloud(CloudMessage { time: header.time, frame: header.frame, bytes, decode }));
        }
        if message.role == TopicRole::Imu {
            return message.decoder().imu().map(SensorMessage::Imu);
        }
        let is_fixed = is_static(&message.topic.name);
        for p in message.decoder().poses(message.role)? {
            self.pending.push_back(match message.role {
                TopicRole::Transforms => {
                    SensorMessage::Transform { time: p.time, parent: p.parent, child: p.child, pose: p.t_parent_child, is_fixed }
                }
                _ => SensorMessage::Pose { time: p.time, child: p.child, pose: p.t_parent_child },
            });
        }
        Ok(self.pending.pop_front().unwrap_or(SensorMessage::Other))
    }
}

/// Whether the transforms of a topic hold at all times.
pub(super) fn is_static(topic: &str) -> bool {
    topic.rsplit('/').next() == Some("tf_static")
}

impl MessageStream for BagStream {
    fn next(&mut self) -> Option<Result<SensorMessage>> {
        if let Some(message) = self.pending.pop_front() {
            return Some(Ok(message));
        }
        let StreamTopics { clouds, poses, imu } = self.topics.clone();
        let wanted = move |t: &Topic, role: TopicRole| match role {
            TopicRole::Transforms => true,
            TopicRole::Imu => Some(&t.name) == imu.as_ref(),
            role if role.is_cloud() => t.name == clouds,
            _ => Some(&t.name) == poses.as_ref(),
        };
        match self.messages.next(&wanted)? {
            Ok(message) => Some(self.decode(message)),
            Err(error) => Some(Err(error)),
        }
    }

    fn now(&self) -> f64 {
        self.now
    }
}
