//! Errors of a trajectory against true poses of the same scans.

use super::tracked::Tracked;
use crate::failure::one_line;
use serde::Serialize;
use std::fmt;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_eval::trajectory::{Ate, Delta, Fit, Rpe, ate, by_id, rpe};
use voxelastic_io::dataset;

/// Path lengths over which relative errors are taken, metres.
const STEPS_M: [f64; 3] = [10.0, 50.0, 100.0];

/// True poses by the nodes of the scans.
#[derive(Debug)]
pub struct TruePoses(Vec<(NodeId, Pose)>);

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
    /// The poses in `file`, or without one in the only file of a folder that is named ground truth.
    ///
    /// # Errors
    /// When `file` cannot be read or does not fit the scans.
    pub fn find(data: &Path, file: Option<&Path>) -> anyhow::Result<Option<Self>> {
        if file.is_none() && !data.is_dir() {
            return Ok(None);
        }
        match dataset::open_truth(data, file) {
            Ok(found) => Ok(found.map(|(_, data)| Self(data.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect()))),
            Err(problem) if file.is_some() => Err(problem.into()),
            Err(problem) => {
                tracing::debug!("no true poses: {}", one_line(&problem.into()));
                Ok(None)
            }
        }
    }

    /// Compares the measured poses with the true ones.
    pub fn errors(&self, tracked: &[Tracked]) -> Option<PathErrors> {
        let measured: Vec<(NodeId, Pose)> = tracked.iter().filter(|t| t.is_tracked()).map(|t| (t.node, *t.pose())).collect();
        let pairs = by_id(&self.0, &measured);
        let ate = ate(&pairs, Fit::Rigid).ok()?;
        let over = |over_m: f64| rpe(&pairs, Delta::Metres(over_m)).ok().map(|rpe| RelativeError { over_m, rpe });
        Some(PathErrors { ate, rpe: STEPS_M.into_iter().filter_map(over).collect() })
    }
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
