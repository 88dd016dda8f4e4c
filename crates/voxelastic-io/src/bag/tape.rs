//! The messages of a recording as what was heard: clouds, poses, transforms; one file after the other.

use super::container::{self, Container, Message, Topic};
use super::messages::{Letter, Role};
use crate::playback::{Heard, HeardCloud, Tape};
use crate::{Result, StampedCloud};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A message with where it is from.
#[derive(Debug)]
pub(super) struct Sent {
    pub(super) path: Arc<Path>,
    pub(super) topic: Topic,
    pub(super) role: Role,
    pub(super) message: Message,
}

impl Sent {
    pub(super) fn letter(&self) -> Letter<'_> {
        Letter { path: &self.path, topic: &self.topic, message: &self.message }
    }

    fn cloud(&self) -> Result<StampedCloud> {
        self.letter().cloud(self.role)
    }
}

/// The messages of all files of a recording.
pub(super) struct Messages {
    files: VecDeque<PathBuf>,
    current: Option<(Arc<Path>, Box<dyn Container>)>,
}

impl Messages {
    pub(super) fn new(files: &[PathBuf]) -> Self {
        Self { files: files.iter().cloned().collect(), current: None }
    }

    /// The next message of a role and topic that are wanted.
    pub(super) fn next(&mut self, wanted: &dyn Fn(&Topic, Role) -> bool) -> Option<Result<Sent>> {
        loop {
            if let Some((path, container)) = &mut self.current {
                let is_wanted = |t: &Topic| Role::of(t).is_some_and(|role| wanted(t, role));
                match container.next(&is_wanted) {
                    Some(Ok(message)) => {
                        let topic = container.topics()[message.topic].clone();
                        let Some(role) = Role::of(&topic) else { continue };
                        return Some(Ok(Sent { path: Arc::clone(path), topic, role, message }));
                    }
                    Some(Err(error)) => return Some(Err(error)),
                    None => self.current = None,
                }
            }
            let file = self.files.pop_front()?;
            match container::open(&file) {
                Ok(container) => self.current = Some((file.into(), container)),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The topics that a tape listens to, besides transforms.
#[derive(Clone, Debug)]
pub(super) struct Listen {
    pub(super) clouds: String,
    pub(super) poses: Option<String>,
}

/// A recording that plays.
pub(super) struct BagTape {
    messages: Messages,
    listen: Listen,
    /// What a message of several poses holds.
    pending: VecDeque<Heard>,
    now: f64,
}

impl BagTape {
    pub(super) fn new(files: &[PathBuf], listen: Listen) -> Self {
        Self { messages: Messages::new(files), listen, pending: VecDeque::new(), now: 0.0 }
    }

    fn hear(&mut self, sent: Sent) -> Result<Heard> {
        self.now = sent.message.time_ns as f64 * 1e-9;
        if sent.role.is_cloud() {
            let header = sent.letter().header()?;
            let bytes = sent.message.data.len();
            let decode = Box::new(move || sent.cloud());
            return Ok(Heard::Cloud(HeardCloud { time: header.time, frame: header.frame, bytes, decode }));
        }
        let is_fixed = is_static(&sent.topic.name);
        for p in sent.letter().poses(sent.role)? {
            self.pending.push_back(match sent.role {
                Role::Transforms => Heard::Transform { time: p.time, parent: p.parent, child: p.child, pose: p.t_parent_child, is_fixed },
                _ => Heard::Pose { time: p.time, child: p.child, pose: p.t_parent_child },
            });
        }
        Ok(self.pending.pop_front().unwrap_or(Heard::Nothing))
    }
}

/// Whether transforms of a topic hold for ever.
pub(super) fn is_static(topic: &str) -> bool {
    topic.rsplit('/').next() == Some("tf_static")
}

impl Tape for BagTape {
    fn next(&mut self) -> Option<Result<Heard>> {
        if let Some(heard) = self.pending.pop_front() {
            return Some(Ok(heard));
        }
        let Listen { clouds, poses } = self.listen.clone();
        let wanted = move |t: &Topic, role: Role| {
            role == Role::Transforms || (role.is_cloud() && t.name == clouds) || (role.is_poses() && Some(&t.name) == poses.as_ref())
        };
        let sent = match self.messages.next(&wanted)? {
            Ok(sent) => sent,
            Err(error) => return Some(Err(error)),
        };
        Some(self.hear(sent))
    }

    fn now(&self) -> f64 {
        self.now
    }
}
