//! What is stored of a submap beside its fields: how the map was made, poses and scans.

use super::pose_as_numbers;
use crate::store::additions::sessions::SessionEntry;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::Submap;
use voxelastic::event::NodeId;

/// How a map was made, in words: stored and given back as it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapDetails {
    /// Program and version that wrote the map.
    pub generator: String,
    /// Settings by key.
    pub settings: BTreeMap<String, String>,
    /// Description of the sensor, by key.
    pub sensor: BTreeMap<String, String>,
}

/// A scan that a submap was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanEntry {
    /// The pose-graph node where it was taken.
    pub node: NodeId,
    /// Pose of the lidar in the submap's frame.
    #[serde(with = "pose_as_numbers")]
    pub t_submap_lidar: Pose,
}

/// A submap, and where it lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Piece<'a> {
    pub submap: &'a Submap,
    pub t_map_submap: Pose,
    /// The session that it was added with; none for those that the map began with.
    pub session: Option<&'a SessionEntry>,
}

/// The scans that `submap` was made from.
pub(crate) fn scan_entries(submap: &Submap) -> Vec<ScanEntry> {
    submap.scans().iter().map(|s| ScanEntry { node: s.node, t_submap_lidar: s.t_submap_lidar }).collect()
}

/// Where the last correction put the scans of `submap`.
pub(crate) fn corrected_entries(submap: &Submap) -> Vec<ScanEntry> {
    submap.scans().iter().zip(submap.corrected()).map(|(s, pose)| ScanEntry { node: s.node, t_submap_lidar: *pose }).collect()
}

/// Refuses a submap whose numbers the manifest of the map in `dir` cannot hold.
pub(crate) fn check_storable(piece: &Piece<'_>, dir: &Path) -> Result<()> {
    let submap = piece.submap;
    let unstorable = |what: String| Error::unwritable(dir, format!("submap {}: {what}", submap.id()));
    pose_as_numbers::check(&piece.t_map_submap).map_err(|e| unstorable(format!("its root pose {e}")))?;
    for scan in submap.scans() {
        pose_as_numbers::check(&scan.t_submap_lidar).map_err(|e| unstorable(format!("the pose of node {} {e}", scan.node)))?;
    }
    for pose in submap.corrected() {
        pose_as_numbers::check(pose).map_err(|e| unstorable(format!("a corrected pose {e}")))?;
    }
    if submap.travelled().is_finite() { Ok(()) } else { Err(unstorable(format!("its travelled distance is {}", submap.travelled()))) }
}
