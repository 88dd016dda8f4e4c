//! What is in a recording: topics and counts from the index, and what its beginning shows.

use super::container::{self, Topic};
use super::messages::Role;
use super::tape::{Messages, is_static};
use crate::Result;
use crate::playback::Tree;
use std::collections::HashMap;
use std::path::PathBuf;

/// The beginning of a recording is looked at for this long at most, in seconds of recording, or this many bytes of messages.
const BEGINNING_S: f64 = 5.0;
/// Transforms are looked at for this long: those that move come more often.
const TRANSFORMS_S: f64 = 1.0;
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

/// What the beginning shows of a topic of clouds.
#[derive(Clone, Debug, Default)]
pub(super) struct Glimpse {
    /// Frame of a cloud.
    pub(super) frame: String,
    /// Fields of a cloud.
    pub(super) fields: Vec<String>,
}

/// What is known of a recording before it is played.
pub(super) struct Survey {
    pub(super) topics: Vec<Topic>,
    /// Messages of each topic, if the index of every file is there.
    pub(super) counts: Option<Vec<u64>>,
    /// Times of the first and the last message, seconds, under the same condition.
    pub(super) times: Option<[f64; 2]>,
    pub(super) glimpses: HashMap<String, Glimpse>,
    /// The transforms of the beginning.
    pub(super) tree: Tree,
    /// What is to be known about the files.
    pub(super) notes: Vec<String>,
}

impl Survey {
    /// Looks at the indices and the beginning.
    ///
    /// # Errors
    /// Those of opening the files.
    pub(super) fn of(files: &[PathBuf]) -> Result<Self> {
        let mut survey =
            Self { topics: Vec::new(), counts: Some(Vec::new()), times: None, glimpses: HashMap::new(), tree: Tree::default(), notes: Vec::new() };
        for file in files {
            let container = match container::open(file) {
                Ok(container) => container,
                // A part that is no recording is reported when its turn comes; a recording of nothing else cannot be opened.
                Err(error) if files.len() > 1 => {
                    survey.counts = None;
                    survey.notes.push(error.to_string());
                    continue;
                }
                Err(error) => return Err(error),
            };
            let index = container.index();
            let has_index = index.is_some();
            survey.add_index(container.topics(), index);
            if !has_index {
                survey.notes.push(format!("{} has no index, as when a recording was not closed: it is read as far as it goes", file.display()));
            }
        }
        survey.look(files);
        Ok(survey)
    }

    fn add_index(&mut self, topics: &[Topic], index: Option<container::Index>) {
        let places: Vec<usize> = topics.iter().map(|t| self.place(t)).collect();
        let (Some(counts), Some(index)) = (&mut self.counts, index) else {
            self.counts = None;
            return;
        };
        counts.resize(self.topics.len(), 0);
        for (place, count) in places.iter().zip(&index.counts) {
            counts[*place] += count;
        }
        if let Some((first, last)) = index.times_ns.map(|(a, b)| (a as f64 * 1e-9, b as f64 * 1e-9)) {
            self.times = Some(self.times.map_or([first, last], |[a, b]| [a.min(first), b.max(last)]));
        }
    }

    fn place(&mut self, topic: &Topic) -> usize {
        let known = self.topics.iter().position(|t| t.name == topic.name && t.kind == topic.kind);
        known.unwrap_or_else(|| {
            self.topics.push(topic.clone());
            self.topics.len() - 1
        })
    }

    /// Looks at the first messages of the topics that matter.
    fn look(&mut self, files: &[PathBuf]) {
        let mut messages = Messages::new(files);
        let (mut first, mut bytes) = (None, 0);
        // Damaged places are reported when the recording is played.
        while let Some(sent) = messages.next(&|_, _| true) {
            let Ok(sent) = sent else { continue };
            let time = sent.message.time_ns as f64 * 1e-9;
            bytes += sent.message.data.len();
            let elapsed = time - *first.get_or_insert(time);
            if elapsed > BEGINNING_S || bytes > BEGINNING_BYTES || self.has_seen_enough(elapsed) {
                break;
            }
            let place = self.place(&sent.topic);
            if let Some(counts) = &mut self.counts {
                counts.resize(self.topics.len().max(place + 1), 0);
            }
            let letter = sent.letter();
            let glimpse = match sent.role {
                Role::Transforms => {
                    let is_fixed = is_static(&sent.topic.name);
                    for p in letter.poses(sent.role).unwrap_or_default() {
                        self.tree.add(&p.parent, &p.child, p.time, p.t_parent_child, is_fixed);
                    }
                    None
                }
                role if role.is_cloud() => {
                    letter.header().ok().map(|h| Glimpse { frame: h.frame, fields: letter.cloud_fields(role).unwrap_or_default() })
                }
                _ => None,
            };
            if let Some(glimpse) = glimpse {
                self.glimpses.entry(sent.topic.name.clone()).or_insert(glimpse);
            }
        }
    }

    /// Whether the rest of the beginning would show nothing new: each topic of clouds was seen, and transforms for a while. Without
    /// an index more topics may come.
    fn has_seen_enough(&self, elapsed: f64) -> bool {
        let clouds = self.of_role(Role::is_cloud);
        let transforms = self.of_role(|role| role == Role::Transforms);
        self.counts.is_some() && clouds.iter().all(|(name, _)| self.glimpses.contains_key(name)) && (transforms.is_empty() || elapsed > TRANSFORMS_S)
    }

    /// Messages of a topic, if that is known.
    pub(super) fn count(&self, topic: &str) -> Option<u64> {
        let counts = self.counts.as_ref()?;
        Some(self.topics.iter().zip(counts).filter(|(t, _)| t.name == topic).map(|(_, n)| n).sum())
    }

    /// Topics of a role that have messages, or may have.
    pub(super) fn of_role(&self, has: impl Fn(Role) -> bool) -> Vec<(String, Role)> {
        let with_role = self.topics.iter().filter_map(|t| Role::of(t).filter(|r| has(*r)).map(|r| (t.name.clone(), r)));
        with_role.filter(|(name, _)| self.count(name) != Some(0)).collect()
    }

    /// The topics by name.
    pub(super) fn summaries(&self) -> Vec<TopicSummary> {
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

/// Counts the messages of a recording without an index, and the time of the first and the last, seconds.
pub(super) fn count_all(files: &[PathBuf]) -> (HashMap<String, u64>, Option<[f64; 2]>) {
    let (mut counts, mut times): (HashMap<String, u64>, Option<[f64; 2]>) = (HashMap::new(), None);
    for file in files {
        let Ok(mut container) = container::open(file) else { continue };
        while let Some(message) = container.next(&|_| true) {
            let Ok(message) = message else { continue };
            let time = message.time_ns as f64 * 1e-9;
            times = Some(times.map_or([time; 2], |[a, b]| [a.min(time), b.max(time)]));
            *counts.entry(container.topics()[message.topic].name.clone()).or_default() += 1;
        }
    }
    (counts, times)
}
