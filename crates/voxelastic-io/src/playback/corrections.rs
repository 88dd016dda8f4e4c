//! Corrected poses that became known while a recording was made: files `poses@SECONDS.tum` in a folder, each a trajectory as it was known
//! then, in the clock of the recording.

use super::track::{LONGEST_GAP_S, Track};
use crate::{Error, Result, poses};
use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// Corrections to come, and the scans that they can be about.
#[derive(Clone, Debug, Default)]
pub(crate) struct Corrections {
    /// When each became known, seconds, and its file; in the order of time.
    files: VecDeque<(f64, PathBuf)>,
    /// The scans that were delivered.
    taken: Vec<Delivered>,
}

/// A scan that was delivered, and the pose that was told of it then.
#[derive(Clone, Debug)]
struct Delivered {
    time: f64,
    node: NodeId,
    told: Pose,
}

/// What a file corrects.
#[derive(Clone, Debug)]
pub(crate) struct Correction {
    /// The lidar's poses at the scans that it is about, in their order.
    pub(crate) poses: Vec<(NodeId, Pose)>,
    /// What was told of the last of them.
    pub(crate) told: Pose,
    /// Its pose now.
    pub(crate) now: Pose,
}

impl Corrections {
    /// Looks for them in a folder.
    ///
    /// # Errors
    /// [`Error::Dataset`] if there are none; [`Error::Io`].
    pub(crate) fn find(folder: &Path) -> Result<Self> {
        let list = |e| Error::io(folder, "list", e);
        let mut files = Vec::new();
        for entry in fs::read_dir(folder).map_err(list)? {
            let path = entry.map_err(list)?.path();
            let time = path.file_stem().and_then(|s| s.to_str()?.strip_prefix("poses@")?.parse().ok()).filter(|t: &f64| t.is_finite());
            files.extend(time.map(|time| (time, path)));
        }
        files.sort_by(|a, b| a.0.total_cmp(&b.0));
        if files.is_empty() {
            let remedy = "name a g2o file, or a folder of trajectories (TUM) that were known at such times: poses@1600000000.5.tum";
            return Err(Error::dataset(folder, "no corrected poses in it", remedy));
        }
        Ok(Self { files: files.into(), taken: Vec::new() })
    }

    /// How many are to come.
    pub(crate) fn len(&self) -> usize {
        self.files.len()
    }

    /// Notes a scan that is delivered, and the pose that was told of it.
    pub(crate) fn note(&mut self, time: f64, node: NodeId, told: Pose) {
        if !self.files.is_empty() {
            self.taken.push(Delivered { time, node, told });
        }
    }

    /// The next file, if it was known before `time` and there are scans that it can be about.
    pub(crate) fn due(&mut self, time: f64) -> Option<PathBuf> {
        self.files.pop_front_if(|(at, _)| *at < time && !self.taken.is_empty()).map(|(_, path)| path)
    }

    /// What a file says of the scans delivered so far; the lidar lies at `t_child_lidar` in what the file's poses are of.
    ///
    /// # Errors
    /// Those of [`read_track`], and when no pose belongs to a scan.
    pub(crate) fn read(&self, path: &Path, t_child_lidar: &Pose, tolerance_s: f64) -> Result<Correction> {
        let track = read_track(path)?;
        let at = |scan: &Delivered| Some((scan.node, track.at(scan.time, LONGEST_GAP_S, tolerance_s)? * t_child_lidar));
        let found: Vec<(&Delivered, (NodeId, Pose))> = self.taken.iter().filter_map(|scan| Some((scan, at(scan)?))).collect();
        let Some((last, (_, now))) = found.last() else {
            return Err(Error::dataset(path, "none of its poses belongs to a scan that was taken before", "use times in the clock of the recording"));
        };
        let (told, now) = (last.told, *now);
        Ok(Correction { poses: found.into_iter().map(|(_, update)| update).collect(), told, now })
    }
}

/// Reads a trajectory that has times.
///
/// # Errors
/// [`Error::Dataset`] if it has none; those of [`poses::read`].
pub(crate) fn read_track(path: &Path) -> Result<Track> {
    let trajectory = poses::read(path)?;
    let Some(times) = trajectory.times else {
        return Err(Error::dataset(path, "poses without times", "give a trajectory with times (TUM, Newer College), in the clock of the recording"));
    };
    let mut track = Track::default();
    times.iter().zip(trajectory.poses).for_each(|(time, pose)| track.add(*time, pose));
    Ok(track)
}
