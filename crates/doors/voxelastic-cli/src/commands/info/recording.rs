//! Description of a recording.

use super::rows::row;
use crate::args::data::DataArgs;
use serde::Serialize;
use voxelastic_io::bag;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct RecordingInfo {
    kind: &'static str,
    /// `ROS 1 bag`, `MCAP`, `ROS 2 sqlite3 bag`.
    format: String,
    files: usize,
    /// Time of the first and of the last message, seconds.
    time_s: Option<[f64; 2]>,
    topics: Vec<TopicInfo>,
    /// The topic of the clouds that `map` would use.
    cloud_topic: Option<String>,
    /// The topics of further sensors that `map` would use, too.
    more_cloud_topics: Vec<String>,
    /// The topic or file of the poses that `map` would use.
    poses: Option<String>,
    /// The reason why it cannot be mapped as it is, if there is one.
    problem: Option<String>,
    notes: Vec<String>,
}

#[derive(Debug, Serialize)]
struct TopicInfo {
    name: String,
    #[serde(rename = "type")]
    kind: String,
    messages: Option<u64>,
    rate_hz: Option<f64>,
}

/// Describes a recording.
pub fn describe(data: &DataArgs) -> anyhow::Result<RecordingInfo> {
    let d = bag::describe(data.path(), &data.options(false))?;
    let duration = d.times.map(|[first, last]| last - first).filter(|s| *s > 0.0);
    let topic = |t: bag::TopicSummary| TopicInfo {
        // N messages have N - 1 intervals.
        rate_hz: t.messages.zip(duration).map(|(n, s)| n.saturating_sub(1) as f64 / s),
        name: t.name,
        kind: t.kind,
        messages: t.messages,
    };
    Ok(RecordingInfo {
        kind: "recording",
        format: d.format.to_string(),
        files: d.files.len(),
        time_s: d.times,
        topics: d.topics.into_iter().map(topic).collect(),
        cloud_topic: d.cloud_topic,
        more_cloud_topics: d.more_cloud_topics,
        poses: d.poses,
        problem: d.problem,
        notes: d.notes,
    })
}

/// The description as rows of a table.
pub fn table(info: &RecordingInfo) -> Vec<(String, String)> {
    let files = if info.files > 1 { format!(" in {} files", info.files) } else { String::new() };
    let mut rows = vec![row("recording", format!("{}{files}", info.format))];
    rows.extend(info.time_s.map(|[first, last]| row("time", format!("{first:.3} to {last:.3} s ({:.1} s)", last - first))));
    let width = info.topics.iter().map(|t| t.name.len()).max().unwrap_or(0);
    for t in &info.topics {
        let count = t.messages.map_or_else(|| "-".to_owned(), |n| n.to_string());
        let rate = t.rate_hz.map_or_else(String::new, |r| format!("{r:7.2} Hz"));
        rows.push(row("topic", format!("{:<width$}  {count:>8}  {rate:>10}  {}", t.name, t.kind)));
    }
    rows.extend(info.cloud_topic.iter().chain(&info.more_cloud_topics).map(|t| row("clouds to map", t)));
    rows.extend(info.poses.as_ref().map(|p| row("poses", p)));
    rows.extend(info.problem.as_ref().map(|p| row("problem", p)));
    rows.extend(info.notes.iter().map(|n| row("note", n)));
    rows
}
