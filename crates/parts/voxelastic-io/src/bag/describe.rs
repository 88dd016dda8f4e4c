//! Looking into a recording without playing it.

use super::containers::files;
use super::containers::format::BagFormat;
use super::containers::open::open;
use super::description::RecordingDescription;
use super::packet_topics::PacketTopics;
use super::summary::{RecordingSummary, count_messages};
use super::topics::{choose, choose_clouds};
use crate::capture::CaptureKind;
use crate::{Error, OpenOptions, Result};
use std::path::{Path, PathBuf};

/// Whether a path is a recording: a file that begins like one, or a folder that holds some.
///
/// # Errors
/// [`Error::Io`], and a folder of recordings of several kinds.
pub fn is_recording(path: &Path) -> Result<bool> {
    files::find(path).map(|found| found.is_some())
}

/// Describes a recording, whether it can be mapped or not. One without an index is read through for the counts.
///
/// # Errors
/// [`Error::Content`] if it is not a recording; [`Error::Io`].
pub fn describe(path: impl AsRef<Path>, options: &OpenOptions) -> Result<RecordingDescription> {
    let path = path.as_ref();
    if is_capture(path)? {
        let (_, mut description) = describe_capture(path, options)?;
        description.problem = options.poses.is_none().then(|| capture_without_poses(path).to_string());
        return Ok(description);
    }
    let (files, mut summary) = summarise(path)?;
    if summary.counts.is_none() {
        let (counts, times) = count_messages(&files);
        summary.counts = Some(summary.topics.iter().map(|t| counts.get(&t.name).copied().unwrap_or(0)).collect());
        summary.times = times;
    }
    let mut description = describe_bag(files, &summary, options)?;
    match choose(&summary, path, options) {
        Ok(chosen) => description.set_topics(&chosen, &summary),
        Err(error) => {
            description.problem = Some(error.to_string());
            let clouds = choose_clouds(&summary, path, options.cloud_topic.as_deref());
            let packets = clouds.and_then(|clouds| PacketTopics::of(&summary, path, &[clouds], options));
            description.notes.extend(packets.map(|packets| packets.notes).unwrap_or_default());
        }
    }
    Ok(description)
}

/// Whether a path is a capture of packets.
pub(super) fn is_capture(path: &Path) -> Result<bool> {
    Ok(path.is_file() && BagFormat::of(path)? == Some(BagFormat::Capture))
}

/// How a capture is read, and its description.
pub(super) fn describe_capture(path: &Path, options: &OpenOptions) -> Result<(CaptureKind, RecordingDescription)> {
    let (kind, notes) = CaptureKind::of(path, options)?;
    let mut description = RecordingDescription::new(vec![path.to_owned()], BagFormat::Capture, options);
    description.notes = notes;
    Ok((kind, description))
}

/// The error about a capture for which no poses were given.
pub(super) fn capture_without_poses(path: &Path) -> Error {
    let remedy = "name a trajectory with times in the sensor's clock (TUM, Newer College) with --poses, or let `voxelastic odometry` make one";
    Error::no_poses(path, "a capture has no poses", remedy)
}

/// The files of a bag and their summary.
pub(super) fn summarise(path: &Path) -> Result<(Vec<PathBuf>, RecordingSummary)> {
    let Some(files) = files::find(path)? else {
        open(path)?;
        return Err(Error::dataset(path, "no recording in it", "name a .bag, .mcap or .db3 file, or the folder that holds them"));
    };
    let summary = RecordingSummary::of(&files)?;
    Ok((files, summary))
}

/// Description of a bag before its topics are chosen.
pub(super) fn describe_bag(files: Vec<PathBuf>, summary: &RecordingSummary, options: &OpenOptions) -> Result<RecordingDescription> {
    let format = files.iter().find_map(|f| BagFormat::of(f).transpose()).transpose()?;
    let Some(format) = format else {
        let first = files.first().map_or(Path::new(""), PathBuf::as_path);
        return Err(Error::dataset(first, "not a recording by its first bytes", "copy or record it again"));
    };
    let mut description = RecordingDescription::new(files, format, options);
    description.topics = summary.topic_summaries();
    description.times = summary.times;
    description.notes = summary.notes.clone();
    Ok(description)
}
