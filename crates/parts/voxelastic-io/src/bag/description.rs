//! What a recording consists of, for people.

use super::containers::format::BagFormat;
use super::messages::packets::PacketLayout;
use super::summary::{RecordingSummary, TopicSummary};
use super::topics::ChosenTopics;
use crate::OpenOptions;
use crate::points::is_time;
use crate::scan_list::Keyframing;
use std::fmt;
use std::path::PathBuf;

/// Distance between keyframes of a recording by default, metres of travel: the paper's (Sec. V).
pub const KEYFRAME_DISTANCE_M: f64 = 2.0;

/// What a recording consists of and which of it is used. [`fmt::Display`] says it in a few lines.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RecordingDescription {
    /// The files, in order.
    pub files: Vec<PathBuf>,
    /// Their format.
    pub format: BagFormat,
    /// All topics, by name.
    pub topics: Vec<TopicSummary>,
    /// Times of the first and the last message, seconds, if the recording has an index or was read through.
    pub times: Option<[f64; 2]>,
    /// The topic of the clouds, of the first sensor if there are several.
    pub cloud_topic: Option<String>,
    /// The topics of the clouds of further sensors.
    pub more_cloud_topics: Vec<String>,
    /// The topic or file of the poses.
    pub poses: Option<String>,
    /// Which scans are taken.
    pub keyframing: Keyframing,
    /// Number of nodes and of loop edges of the graph given with the recording.
    pub graph: Option<[usize; 2]>,
    /// Why the recording cannot be mapped as it is, if so.
    pub problem: Option<String>,
    /// Further remarks.
    pub notes: Vec<String>,
}

impl RecordingDescription {
    pub(super) fn new(files: Vec<PathBuf>, format: BagFormat, options: &OpenOptions) -> Self {
        Self {
            files,
            format,
            topics: Vec::new(),
            times: None,
            cloud_topic: None,
            more_cloud_topics: Vec::new(),
            poses: options.poses.as_ref().map(|p| p.display().to_string()),
            keyframing: options.keyframing.unwrap_or(Keyframing::Metres(KEYFRAME_DISTANCE_M)),
            graph: None,
            problem: None,
            notes: Vec::new(),
        }
    }

    /// Notes the chosen topics, and which of their clouds have no times of points: nothing undistorts them.
    pub(super) fn set_topics(&mut self, chosen: &ChosenTopics, summary: &RecordingSummary) {
        let timeless = |name: &&String| summary.cloud_topics.get(*name).is_some_and(|topic| !topic.fields.iter().any(|field| is_time(field)));
        for name in chosen.clouds.iter().filter(timeless) {
            let fields = summary.cloud_topics[name].fields.join(" ");
            self.notes.push(format!("clouds of {name} have no times of points ({fields}): what the sensor moved during a sweep is not corrected"));
        }
        self.cloud_topic = chosen.clouds.first().cloned();
        self.more_cloud_topics = chosen.clouds.iter().skip(1).cloned().collect();
        self.notes.extend(without_stamps(&chosen.without_stamps));
        self.notes.extend(chosen.packets.notes.iter().chain(&chosen.remark).cloned());
        if self.poses.is_none() {
            self.poses = chosen.poses.as_ref().map(|(name, _)| name.clone());
        }
    }
}

impl fmt::Display for RecordingDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "recording: {}", self.format)?;
        if self.files.len() > 1 {
            write!(f, " in {} files", self.files.len())?;
        }
        if let Some([first, last]) = self.times {
            write!(f, ", {:.1} s", last - first)?;
        }
        let count = |name: &String| {
            let topic = self.topics.iter().find(|t| t.name == *name)?;
            let what = if PacketLayout::of(&topic.kind).is_some() { " messages of packets" } else { "" };
            topic.messages.map(|n| format!(", {n}{what}"))
        };
        let counted = |name: &String| count(name).map_or_else(|| name.clone(), |count| name.clone() + &count);
        if let Some(topic) = &self.cloud_topic {
            write!(f, "\nclouds: {}", counted(topic))?;
        }
        self.more_cloud_topics.iter().try_for_each(|topic| write!(f, "; {}", counted(topic)))?;
        if let Some(poses) = &self.poses {
            write!(f, "\nposes: {}", counted(poses))?;
        }
        if let Some([nodes, loops]) = self.graph {
            write!(f, "\ngraph: {nodes} nodes, {loops} loop edges")?;
        }
        if let Some(problem) = &self.problem {
            write!(f, "\nproblem: {problem}")?;
        } else {
            write!(f, "\nkeyframes: {}", self.keyframing)?;
        }
        self.notes.iter().try_for_each(|note| write!(f, "\nnote: {note}"))
    }
}

/// What is said of topics whose messages have time stamps of zero.
pub(super) fn without_stamps(topics: &[String]) -> Option<String> {
    let words = "time stamps are zero, so the times at which messages were recorded are taken: these are later than those of the measurements";
    (!topics.is_empty()).then(|| format!("{}: {words}; set stamps in the driver", topics.join(", ")))
}
