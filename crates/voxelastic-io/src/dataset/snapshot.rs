//! Corrected poses that became known after a scan.

use super::folder::Snapshot;
use super::{ScanEntry, in_lidar_frame};
use crate::playback::{LONGEST_GAP_S, Track, sweep};
use crate::{Error, Result, poses};
use std::collections::HashSet;
use voxelastic::event::NodeId;
use voxelastic::{Cloud, Pose};

/// What is needed to tell whose poses a snapshot holds.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) t_base_lidar: Option<Pose>,
    /// Node of every cloud of the folder.
    pub(super) nodes: Vec<NodeId>,
    /// Time of every cloud, if known, seconds.
    pub(super) times: Option<Vec<f64>>,
    /// Poses of the lidar by time, if clouds are to be told how it moved.
    pub(super) track: Option<Track>,
}

impl Context {
    /// The cloud, told how the lidar moved while it was taken, if that is known.
    pub(super) fn in_motion(&self, mut cloud: Cloud, entry: &ScanEntry) -> Cloud {
        if let Some(track) = &self.track {
            cloud.motion = sweep::motion(&cloud, entry.time, &entry.t_map_lidar, |time| track.at(time, LONGEST_GAP_S, 0.0));
        }
        cloud
    }
}

/// Times of the same pose, written with different precision, seconds.
const SAME_TIME_S: f64 = 1e-3;

/// Reads a snapshot: the poses of nodes that have been seen. A graph names its nodes; a trajectory with times is matched by
/// them, if the clouds have times; else line k belongs to cloud k.
pub(super) fn read(snapshot: &Snapshot, context: &Context, seen: &HashSet<NodeId>) -> Result<Vec<(NodeId, Pose)>> {
    let path = &snapshot.file.path;
    let trajectory = in_lidar_frame(poses::read(path)?, context.t_base_lidar.as_ref());
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
    updates.retain(|(node, _)| seen.contains(node));
    if updates.is_empty() {
        return Err(Error::dataset(path, "none of its poses belongs to a scan that was seen", "write the poses of the scans up to its own"));
    }
    Ok(updates)
}
