//! Errors of a trajectory against true poses of the same scans.

use super::tracked::Tracked;
use crate::failure::{Failure, one_line};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_eval::trajectory::{Ate, Delta, Fit, Rpe, ate, by_id, rpe};
use voxelastic_io::{dataset, poses};

/// Path lengths over which relative errors are taken, metres.
const STEPS_M: [f64; 3] = [10.0, 50.0, 100.0];

/// Scans and true poses belong together if their times differ by no more, seconds.
const TOLERANCE_S: f64 = 0.005;

/// True poses of the scans.
#[derive(Debug)]
pub enum TruePoses {
    /// By the nodes of a folder's scans.
    ByNode(Vec<(NodeId, Pose)>),
    /// By time, ascending, of a recording.
    ByTime(Vec<(f64, Pose)>),
}

/// Errors of the poses.
#[derive(Debug, Serialize)]
pub struct PathErrors {
    /// Absolute, after the best rigid alignment.
    pub ate: Ate,
    /// Relative, over 10, 50 and 100 m of path, as far as the path is that long.
    pub rpe: Vec<RelativeError>,
}

/// Relative errors over one length of path.
#[derive(Debug, Serialize)]
pub struct RelativeError {
    /// The length, metres.
    pub over_m: f64,
    #[serde(flatten)]
    pub rpe: Rpe,
}

impl TruePoses {
    /// The poses in `file`, or without one in the only file of a folder that is named ground truth; for a recording in `groundtruth.tum` in its folder.
    ///
    /// # Errors
    /// When `file` cannot be read or does not fit the scans.
    pub fn find(data: &Path, is_recording: bool, file: Option<&Path>) -> anyhow::Result<Option<Self>> {
        if is_recording {
            return of_recording(data, file);
        }
        if file.is_none() && !data.is_dir() {
            return Ok(None);
        }
        match dataset::open_truth(data, file) {
            Ok(found) => Ok(found.map(|(_, data)| Self::ByNode(data.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect()))),
            Err(problem) if file.is_some() => Err(problem.into()),
            Err(problem) => {
                tracing::debug!("no true poses: {}", one_line(&problem.into()));
                Ok(None)
            }
        }
    }

    /// Compares the measured poses with the true ones.
    pub fn errors(&self, tracked: &[Tracked]) -> Option<PathErrors> {
        let is_tracked = || tracked.iter().filter(|t| t.is_tracked());
        let measured: Vec<(NodeId, Pose)> = is_tracked().map(|t| (t.node, *t.pose())).collect();
        let pairs = match self {
            Self::ByNode(poses) => by_id(poses, &measured),
            Self::ByTime(poses) => by_id(&is_tracked().filter_map(|t| Some((t.node, nearest(poses, t.time)?))).collect::<Vec<_>>(), &measured),
        };
        let ate = ate(&pairs, Fit::Rigid).ok()?;
        let over = |over_m: f64| rpe(&pairs, Delta::Metres(over_m)).ok().map(|rpe| RelativeError { over_m, rpe });
        Some(PathErrors { ate, rpe: STEPS_M.into_iter().filter_map(over).collect() })
    }
}

/// The poses for a recording: in `file`, by its path or in the folder of the recording, else in `groundtruth.tum`.
fn of_recording(data: &Path, file: Option<&Path>) -> anyhow::Result<Option<TruePoses>> {
    let folder = if data.is_dir() { data } else { data.parent().unwrap_or(Path::new("")) };
    let in_folder = folder.join(file.unwrap_or(Path::new("groundtruth.tum")));
    let path = match file {
        Some(file) if file.is_file() => file,
        None if !(data.is_dir() && in_folder.is_file()) => return Ok(None),
        _ => &in_folder,
    };
    let trajectory = poses::read(path)?;
    let Some(times) = trajectory.times else {
        let remedy = "give true poses with times (TUM): the scans of a recording are known by theirs";
        return Err(Failure::new(format!("{}: its poses have no times", path.display()), remedy).into());
    };
    let mut timed: Vec<(f64, Pose)> = times.into_iter().zip(trajectory.poses).collect();
    timed.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(Some(TruePoses::ByTime(timed)))
}

/// The pose nearest in time, if it is near enough.
fn nearest(poses: &[(f64, Pose)], time: f64) -> Option<Pose> {
    let after = poses.partition_point(|(t, _)| *t < time);
    let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|k| poses.get(k));
    let best = around.min_by(|a, b| (a.0 - time).abs().total_cmp(&(b.0 - time).abs()))?;
    ((best.0 - time).abs() <= TOLERANCE_S).then_some(best.1)
}

impl fmt::Display for PathErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "error: {:.3} m (root mean square after alignment)", self.ate.translation_m.rmse)?;
        for RelativeError { over_m, rpe } in &self.rpe {
            if let Some(drift) = rpe.drift_percent {
                write!(f, "; over {over_m} m {drift:.2} %, {:.2} degrees", rpe.rotation_deg.mean)?;
            }
        }
        Ok(())
    }
}
