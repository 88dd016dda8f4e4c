//! Reading snapshots: corrected poses that became known after a scan.

use super::pose_file::Snapshot;
use crate::motion::{LONGEST_GAP_S, PoseTrack, sweep_motion};
use crate::scan_list::ScanEntry;
use crate::stamped_cloud::SweepTime;
use crate::{Error, Result, poses};
use std::collections::HashSet;
use std::sync::Arc;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseChange;
use voxelastic::{Cloud, Pose};

/// Times that differ by no more than this are equal up to their precision in the file, seconds.
const SAME_TIME_S: f64 = 1e-3;

/// What is needed to match the poses of a snapshot to scans, and to give clouds their motion.
#[derive(Clone, Debug)]
pub(super) struct SnapshotContext {
    pub(super) t_base_lidar: Option<Pose>,
    pub(super) pose_change: PoseChange,
    /// Node of every cloud of the folder.
    pub(super) nodes: Vec<NodeId>,
    /// Time of every cloud, if known, seconds.
    pub(super) times: Option<Vec<f64>>,
    /// How long a sweep takes.
    pub(super) sweeps: SweepTime,
    /// Whether scans have times.
    pub(super) has_times: bool,
    /// Poses of the lidar by time, if clouds are to get the lidar's motion.
    pub(super) track: Option<Arc<PoseTrack>>,
    /// The same of further sensors.
    pub(super) further: Vec<Option<Arc<PoseTrack>>>,
}

impl SnapshotContext {
    /// The cloud with the lidar's motion during its sweep, if that is known.
    pub(super) fn with_motion(&self, mut cloud: Cloud, entry: &ScanEntry) -> Cloud {
        let track = match entry.sensor.checked_sub(1) {
            None => self.track.as_ref(),
            Some(k) => self.further.get(usize::from(k)).and_then(Option::as_ref),
        };
        if let Some(track) = track {
            cloud.motion = sweep_motion(&cloud, entry.time, &entry.t_map_lidar, |time| track.at(time, LONGEST_GAP_S, 0.0));
        }
        cloud
    }
}

/// Reads a snapshot: the poses of delivered nodes. A graph names its nodes; a trajectory with times is matched by
/// them, if the clouds have times; else line k belongs to cloud k.
pub(super) fn read(snapshot: &Snapshot, context: &SnapshotContext, delivered: &HashSet<NodeId>) -> Result<Vec<(NodeId, Pose)>> {
    let path = &snapshot.file.path;
    let trajectory = poses::read(path)?.changed(&context.pose_change).in_lidar_frame(context.t_base_lidar.as_ref());
    let mut updates: Vec<(NodeId, Pose)> = match (&trajectory.nodes, &trajectory.times, &context.times) {
        (Some(ids), ..) => ids.iter().copied().zip(trajectory.poses).collect(),
        (None, Some(pose_times), Some(cloud_times)) => {
            let node = |time: f64| {
                let k = cloud_times.partition_point(|t| *t < time - SAME_TIME_S);
                cloud_times.get(k).filter(|t| (**t - time).abs() <= SAME_TIME_S).map(|_| context.nodes[k])
            };
            pose_times.iter().zip(trajectory.poses).filter_map(|(t, pose)| node(*t).map(|n| (n, pose))).collect()
        }
        _ if trajectory.len() <= context.nodes.len() => context.nodes.iter().copied().zip(trajectory.poses).collect(),
        _ => {
            let problem = format!("{} poses for {} clouds", trajectory.len(), context.nodes.len());
            return Err(Error::dataset(path, problem, "write one pose per cloud, in the order of the clouds"));
        }
    };
    updates.retain(|(node, _)| delivered.contains(node));
    if updates.is_empty() {
        return Err(Error::dataset(path, "none of its poses belongs to a scan before it", "write the poses of the scans up to its own"));
    }
    Ok(updates)
}
