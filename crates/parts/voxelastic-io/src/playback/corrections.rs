//! Corrected poses that became known during a recording: files `poses@SECONDS.tum` in a folder, each a trajectory as it was known at that
//! time, in the clock of the recording.

use super::robot_mounts::sensor_of;
use crate::motion::{LONGEST_GAP_S, PoseTrack};
use crate::{Error, Result, poses};
use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseChange;

/// Corrections that are still to come, and the scans that they can apply to.
#[derive(Clone, Debug, Default)]
pub(crate) struct Corrections {
    /// When each became known, seconds, and its file; ordered by time.
    files: VecDeque<(f64, PathBuf)>,
    /// The scans delivered so far.
    delivered: Vec<Delivered>,
    /// Whether corrections come as messages.
    by_message: bool,
}

/// A delivered scan and the pose that was reported for it.
#[derive(Clone, Debug)]
struct Delivered {
    time: f64,
    node: NodeId,
    reported: Pose,
    /// Pose of its lidar in the frame that corrected poses are of.
    t_child_lidar: Pose,
}

/// What a file corrects.
#[derive(Clone, Debug)]
pub(crate) struct Correction {
    /// The lidar's corrected poses at the scans that the file covers, in order.
    pub(crate) poses: Vec<(NodeId, Pose)>,
    /// The reported pose of the last of them.
    pub(crate) reported: Pose,
    /// Its corrected pose.
    pub(crate) corrected: Pose,
}

impl Corrections {
    /// Lists the corrections in a folder.
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
        Ok(Self { files: files.into(), ..Self::default() })
    }

    /// Corrections that come as messages.
    pub(crate) fn by_message() -> Self {
        Self { by_message: true, ..Self::default() }
    }

    /// Number of corrections to come.
    pub(crate) fn len(&self) -> usize {
        self.files.len()
    }

    /// Notes a delivered scan and the pose that was reported for it. `t_child_lidar` is its lidar's pose in the frame that corrected poses are of.
    pub(crate) fn note(&mut self, time: f64, node: NodeId, reported: Pose, t_child_lidar: Pose) {
        if self.by_message || !self.files.is_empty() {
            self.delivered.push(Delivered { time, node, reported, t_child_lidar });
        }
    }

    /// The lidar of a sensor was elsewhere on what the poses are of: `t_old_new` is its place in the frame of the one that was thought.
    pub(crate) fn remount(&mut self, sensor: u16, t_old_new: &Pose) {
        for scan in self.delivered.iter_mut().filter(|scan| sensor_of(scan.node) == sensor) {
            scan.reported *= t_old_new;
            scan.t_child_lidar *= t_old_new;
        }
    }

    /// Takes the next file, if it was known before `time` and scans have been delivered that it can apply to.
    pub(crate) fn take_due(&mut self, time: f64) -> Option<PathBuf> {
        self.files.pop_front_if(|(at, _)| *at < time && !self.delivered.is_empty()).map(|(_, path)| path)
    }

    /// Reads the corrections of the scans delivered so far.
    ///
    /// # Errors
    /// Those of [`read_track`], and [`Error::Dataset`] if no pose belongs to a scan.
    pub(crate) fn read(&self, path: &Path, change: &PoseChange, tolerance_s: f64) -> Result<Correction> {
        let track = read_track(path, change)?;
        self.find_in(&track, tolerance_s).ok_or_else(|| {
            Error::dataset(path, "none of its poses belongs to a scan that was taken before", "use times in the clock of the recording")
        })
    }

    /// The corrections in a trajectory of the scans delivered so far; `None` if it has a pose of none of them.
    pub(crate) fn find_in(&self, track: &PoseTrack, tolerance_s: f64) -> Option<Correction> {
        let at = |scan: &Delivered| Some((scan.node, track.at(scan.time, LONGEST_GAP_S, tolerance_s)? * scan.t_child_lidar));
        let found: Vec<(&Delivered, (NodeId, Pose))> = self.delivered.iter().filter_map(|scan| Some((scan, at(scan)?))).collect();
        let (last, (_, corrected)) = found.last()?;
        let (reported, corrected) = (last.reported, *corrected);
        Some(Correction { poses: found.into_iter().map(|(_, update)| update).collect(), reported, corrected })
    }
}

/// Reads a trajectory that has times.
///
/// # Errors
/// [`Error::Dataset`] if it has none; those of [`poses::read`].
pub(crate) fn read_track(path: &Path, change: &PoseChange) -> Result<PoseTrack> {
    let trajectory = poses::read(path)?;
    let Some(times) = trajectory.times else {
        return Err(Error::dataset(path, "poses without times", "give a trajectory with times (TUM, Newer College), in the clock of the recording"));
    };
    let mut track = PoseTrack::default();
    times.iter().zip(trajectory.poses).for_each(|(time, pose)| track.add(*time, pose));
    Ok(track.changed(change))
}
