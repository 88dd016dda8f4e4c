//! The nodes of a saved map with their poses, times and edges; and the map with other poses.

use crate::error::Result;
use crate::map_files;
use std::collections::{BTreeMap, HashMap};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::Origin;
use voxelastic_io::store::{MapStore, ScanEntry, SubmapEntry};

/// Where scans are inside of their submap is noted anew if one has moved by more than this, in voxels.
const TOLERANCE: f64 = 0.25;
/// Turning a scan matters at this distance, metres.
const FAR: f64 = 10.0;

/// What a saved map knows of its scans.
pub struct Nodes {
    /// Poses after all corrections, map frame, by node.
    pub poses: Vec<(NodeId, Pose)>,
    /// Times of nodes that the log of the run has.
    pub times: HashMap<NodeId, f64>,
    /// Between neighbours of a session, and loops.
    pub edges: Vec<Edge>,
}

impl Nodes {
    /// Of a map.
    ///
    /// # Errors
    /// A damaged origin.
    pub fn of(store: &MapStore) -> Result<Self> {
        let origin = map_files::origin_of(store)?;
        let manifest = store.manifest();
        let mut all: BTreeMap<NodeId, (u32, Pose)> = BTreeMap::new();
        let sessions = manifest.all_sessions();
        for entry in &manifest.submaps {
            let session = sessions.iter().find(|session| session.has(entry.id)).map_or(0, |session| session.number);
            for (node, t_submap_lidar) in now(entry) {
                all.insert(node, (session, origin.to_map(entry.t_map_submap * t_submap_lidar)));
            }
        }
        let log = map_files::run_log(store).unwrap_or_default();
        let times = log.scans.node.iter().copied().zip(log.scans.time_s.iter().copied()).filter(|(node, _)| all.contains_key(node)).collect();
        let between = |from: NodeId, to: NodeId| {
            let (a, b) = (all.get(&from)?, all.get(&to)?);
            Some(Edge { from, to, t_from_to: a.1.inv_mul(&b.1), information: None })
        };
        let listed: Vec<(NodeId, u32)> = all.iter().map(|(node, (session, _))| (*node, *session)).collect();
        let mut edges: Vec<Edge> = listed.windows(2).filter(|pair| pair[0].1 == pair[1].1).filter_map(|pair| between(pair[0].0, pair[1].0)).collect();
        // What loops measured is not kept. The poses agree with them since they were corrected.
        edges.extend(log.loops.iter().filter(|edge| edge.from != edge.to).filter_map(|edge| between(edge.from, edge.to)));
        edges.extend(sessions.iter().flat_map(|session| &session.loop_edges).filter_map(|edge| between(edge.from, edge.to)));
        let poses = all.into_iter().map(|(node, (_, pose))| (node, pose)).collect();
        Ok(Self { poses, times, edges })
    }
}

/// The scans of a submap where the last correction put them, in its frame.
fn now(entry: &SubmapEntry) -> impl Iterator<Item = (NodeId, Pose)> {
    entry.scans.iter().enumerate().map(|(n, scan)| (scan.node, entry.corrected.get(n).unwrap_or(scan).t_submap_lidar))
}

/// Puts a submap where its first scan is, by `poses` in the map frame, and notes where the others are in it then.
pub fn move_submap(entry: &mut SubmapEntry, poses: &HashMap<NodeId, Pose>, origin: Origin, voxel: f64) {
    let before: Vec<(NodeId, Pose)> = now(entry).collect();
    let pose = |node: &NodeId| poses.get(node).map(|pose| origin.to_local(*pose));
    let Some((root, t_submap_root)) = before.iter().find_map(|(node, t)| Some((pose(node)?, *t))) else { return };
    let t_map_submap = root * t_submap_root.inverse();
    let moved = |(node, t): &(NodeId, Pose)| pose(node).map_or(*t, |pose| t_map_submap.inv_mul(&pose));
    let corrected: Vec<Pose> = before.iter().map(moved).collect();
    let tolerance = TOLERANCE * voxel;
    let has_moved = |(a, (_, b)): (&Pose, &(NodeId, Pose))| a.translation_distance(b) > tolerance || a.rotation_distance(b) * FAR > tolerance;
    if corrected.iter().zip(&before).any(has_moved) {
        entry.corrected = before.iter().zip(corrected).map(|((node, _), t_submap_lidar)| ScanEntry { node: *node, t_submap_lidar }).collect();
    }
    entry.t_map_submap = t_map_submap;
}
