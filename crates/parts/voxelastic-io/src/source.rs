//! Scans and poses from a folder or a recording.

use crate::bag::{self, Recording, RecordingEvents};
use crate::clouds::CloudFormat;
use crate::dataset::{self, Dataset};
use crate::folders::holds_clouds;
use crate::read_ahead::IdleStep;
use crate::read_position::{Place, ReadPosition};
use crate::scan_list::undistorted_sign_of;
use crate::{Error, OpenOptions, Result};
use std::collections::HashMap;
use std::path::Path;
use voxelastic::Cloud;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;

/// A registered cloud list that can be read as [`Event`]s.
#[derive(Debug)]
#[non_exhaustive]
pub enum Source {
    /// A folder of clouds and poses.
    Folder(Box<Dataset>),
    /// A recording of ROS 1 or ROS 2.
    Recording(Box<Recording>),
}

/// Opens a folder, a recording or an E57 file of laser scans, which is treated as a folder. A folder that holds both clouds and recordings is treated as a folder of clouds.
///
/// # Errors
/// Those of [`dataset::open`] and [`Recording::open`].
pub fn open(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Source> {
    let path = path.as_ref();
    let is_recording = (path.is_file() && CloudFormat::of(path) != Some(CloudFormat::E57)) || (!holds_clouds(path) && bag::is_recording(path)?);
    if is_recording && !options.more_folders.is_empty() {
        return Err(Error::dataset(
            path,
            "a recording, which has all of its sensors",
            "name the further sensor with --cloud-topic instead of --also",
        ));
    }
    if is_recording {
        Recording::open(path, options).map(|r| Source::Recording(Box::new(r)))
    } else {
        dataset::open(path, options).map(|d| Source::Folder(Box::new(d)))
    }
}

impl Source {
    /// The path that was opened.
    pub fn path(&self) -> &Path {
        match self {
            Self::Folder(folder) => folder.path(),
            Self::Recording(recording) => recording.path(),
        }
    }

    /// What was found, in a few lines.
    pub fn description(&self) -> String {
        match self {
            Self::Folder(folder) => folder.description().to_string(),
            Self::Recording(recording) => recording.description().to_string(),
        }
    }

    /// What speaks for clouds that are undistorted already, although their points have times. Of a folder, the first cloud is read.
    pub fn undistorted_sign(&self) -> Option<String> {
        match self {
            Self::Folder(folder) => folder.scans().first().and_then(|scan| undistorted_sign_of(&scan.path, scan.index)),
            Self::Recording(recording) => recording.undistorted_sign(),
        }
    }

    /// The usual time between the clouds of the first sensor, seconds, if a sweep can take that long.
    pub fn interval_s(&self) -> Option<f64> {
        match self {
            Self::Folder(folder) => folder.interval_s(),
            Self::Recording(recording) => recording.interval_s(),
        }
    }

    /// Number of scans, if it is known before they are read.
    pub fn scans(&self) -> Option<usize> {
        match self {
            Self::Folder(folder) => Some(folder.scans().len()),
            Self::Recording(_) => None,
        }
    }

    /// How much of a recording has been played, 0 to 1, if known.
    pub fn progress(&self) -> Option<f64> {
        match self {
            Self::Folder(_) => None,
            Self::Recording(recording) => recording.progress(),
        }
    }

    /// The sensor's own tables of beams, if the data contain them: those of an Ouster capture.
    pub fn sensor(&self) -> Option<BeamModel> {
        match self {
            Self::Folder(_) => None,
            Self::Recording(recording) => recording.sensor(),
        }
    }

    /// Clouds without a pose, as far as known.
    pub fn without_pose(&self) -> usize {
        match self {
            Self::Folder(folder) => folder.description().without_pose.len(),
            Self::Recording(recording) => recording.without_pose(),
        }
    }

    /// Keeps only the scans for which `keep` holds, by their index among those of their sensor taken so far.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool + Send + Sync + 'static) {
        match self {
            Self::Folder(folder) => {
                let mut indices: HashMap<u16, usize> = HashMap::new();
                folder.retain(|scan| {
                    let index = indices.entry(scan.sensor).or_default();
                    *index += 1;
                    keep(*index - 1)
                });
            }
            Self::Recording(recording) => recording.retain(keep),
        }
    }

    /// Takes no more than the first `most` scans.
    pub fn limit(&mut self, most: usize) {
        match self {
            Self::Folder(folder) => folder.truncate(most),
            Self::Recording(recording) => recording.limit(most),
        }
    }

    /// The registered cloud list.
    pub fn events(&self) -> Events {
        match self {
            Self::Folder(folder) => Events::Folder(Box::new(folder.events())),
            Self::Recording(recording) => Events::Recording(recording.events()),
        }
    }

    /// The events, for a look at their beginning: clouds without a pose are counted in [`events`](Self::events) only.
    pub fn preview(&self) -> Events {
        match self {
            Self::Folder(_) => self.events(),
            Self::Recording(recording) => Events::Recording(recording.preview()),
        }
    }

    /// The events from a position on, of the same data. Those of a recording are read from its beginning, and the first
    /// [`items_to_skip`](ReadPosition::items_to_skip) are to be dropped by the caller.
    pub fn events_from(&self, position: ReadPosition) -> Events {
        match (self, position.0) {
            (Self::Folder(folder), Place::Folder(place)) => Events::Folder(Box::new(folder.events_from(place))),
            _ => self.events(),
        }
    }

    /// A number that differs, as a rule, for other data: other scans, poses, edges or files that were changed since.
    pub fn fingerprint(&self) -> u64 {
        match self {
            Self::Folder(folder) => folder.fingerprint(),
            Self::Recording(recording) => recording.fingerprint(),
        }
    }

    /// Reads clouds again that [`events`](Self::events) delivered.
    pub fn clouds(&self) -> Box<dyn ScanSource + Send> {
        match self {
            Self::Folder(folder) => {
                Box::new(Files { indices: folder.scans().iter().enumerate().map(|(k, scan)| (scan.node, k)).collect(), folder: (**folder).clone() })
            }
            Self::Recording(recording) => Box::new(recording.clouds()),
        }
    }
}

/// Iterator over the events of a [`Source`], read ahead on a thread of its own or by an [`IdleStep`].
#[derive(Debug)]
#[non_exhaustive]
pub enum Events {
    /// Those of a folder.
    Folder(Box<dataset::Events>),
    /// Those of a recording.
    Recording(RecordingEvents),
}

impl Events {
    /// A function that reads one event ahead in the time of the calling thread, see [`IdleStep`].
    pub fn idle_step(&mut self) -> IdleStep {
        match self {
            Self::Folder(events) => events.idle_step(),
            Self::Recording(events) => events.idle_step(),
        }
    }

    /// Where it is; none between the events of one scan.
    pub fn read_position(&self) -> Option<ReadPosition> {
        Some(ReadPosition(match self {
            Self::Folder(events) => Place::Folder(events.read_position()?),
            Self::Recording(events) => Place::Recording { items: events.taken() },
        }))
    }
}

impl Iterator for Events {
    type Item = Result<Event>;

    fn next(&mut self) -> Option<Result<Event>> {
        match self {
            Self::Folder(events) => events.next(),
            Self::Recording(events) => events.next(),
        }
    }
}

/// Reads the clouds of a folder again.
struct Files {
    folder: Dataset,
    /// Index of each node's scan.
    indices: HashMap<NodeId, usize>,
}

impl ScanSource for Files {
    fn cloud(&mut self, node: NodeId) -> std::result::Result<Cloud, Box<dyn std::error::Error + Send + Sync>> {
        let index = self.indices.get(&node).ok_or("no scan of the data belongs to it")?;
        Ok(self.folder.cloud(&self.folder.scans()[*index])?)
    }
}
