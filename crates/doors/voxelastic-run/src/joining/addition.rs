//! What is added to a map: submaps of a session, with other numbers and corrected poses.

use std::collections::HashMap;
use std::time::{SystemTime, UNIX_EPOCH};
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId, SubmapScan};
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::{MapWriter, SaveReport, SessionEntry, StoredFrame};
use voxelastic_slam::join::Joined;

/// Where scans are inside of their submap is noted anew if one has moved by more than this, in voxels.
const TOLERANCE: f64 = 0.25;
/// Turning a scan matters at this distance, metres.
const FAR: f64 = 10.0;

/// What is added to the numbers of submaps and nodes.
#[derive(Clone, Copy, Debug)]
pub struct Offsets {
    pub submap: SubmapId,
    pub node: NodeId,
}

/// A session, ready to be added to a map.
pub struct Addition {
    offsets: Offsets,
    poses: HashMap<NodeId, Pose>,
    t_first_second: Pose,
    /// All sessions of the map then.
    sessions: Vec<SessionEntry>,
    voxel: f32,
}

impl Addition {
    /// Of nodes that were joined to a map, which then has these sessions.
    pub fn new(offsets: Offsets, joined: Joined, sessions: Vec<SessionEntry>, voxel: f32) -> Self {
        Self { offsets, poses: joined.poses.into_iter().collect(), t_first_second: joined.t_first_second, sessions, voxel }
    }

    /// Adds the submaps of `atlas` to the map of `writer`. To be called in a pool.
    pub fn save(&self, writer: &mut MapWriter, atlas: &Atlas) -> voxelastic_io::Result<SaveReport> {
        writer.add_session(atlas, |submap| self.placed(submap), self.sessions.clone())
    }

    /// A submap as it is in the map.
    fn placed(&self, submap: &Submap) -> Submap {
        let now: Vec<Pose> = submap.corrected_scans().map(|(_, t_submap_lidar)| *t_submap_lidar).collect();
        let node = |scan: &SubmapScan| scan.node + self.offsets.node;
        let pose = |scan: &SubmapScan, t: &Pose| self.poses.get(&node(scan)).copied().unwrap_or(self.t_first_second * submap.t_map_submap() * t);
        let root = submap.scans().first().zip(now.first()).map(|(scan, t)| pose(scan, t) * t.inverse());
        let t_map_submap = root.unwrap_or(self.t_first_second * submap.t_map_submap());
        let corrected: Vec<Pose> = submap.scans().iter().zip(&now).map(|(scan, t)| t_map_submap.inv_mul(&pose(scan, t))).collect();
        let tolerance = TOLERANCE * f64::from(self.voxel);
        let has_moved = |(a, b): (&Pose, &Pose)| a.translation_distance(b) > tolerance || a.rotation_distance(b) * FAR > tolerance;
        let is_bent = corrected.iter().zip(&now).any(has_moved);
        let scans = submap.scans().iter().map(|scan| SubmapScan { node: node(scan), t_submap_lidar: scan.t_submap_lidar }).collect();
        let corrected = if is_bent { corrected } else { submap.corrected().to_vec() };
        let mut placed = submap.clone().with_id(submap.id() + self.offsets.submap).with_scans(scans, submap.travelled()).with_corrected(corrected);
        placed.set_pose(t_map_submap);
        placed
    }
}

/// The sessions that are added, as the map has them after those `before`. An edge belongs to the session that its second node is of.
pub fn sessions(
    added: &[SessionEntry],
    before: &[SessionEntry],
    offsets: Offsets,
    t_map_added: &Pose,
    edges: &[Edge],
    atlas: &Atlas,
) -> Vec<SessionEntry> {
    let last = before.last().map_or(0, |session| session.number);
    let submap_of: HashMap<NodeId, SubmapId> =
        atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(|scan| (scan.node + offsets.node, submap.id()))).collect();
    let now = now();
    let session = |(old, number): (&SessionEntry, u32)| {
        let own = edges.iter().filter(|edge| submap_of.get(&edge.to).is_some_and(|id| old.has(*id)));
        let moved = old.loop_edges.iter().cloned().map(|mut edge| {
            (edge.from, edge.to) = (edge.from + offsets.node, edge.to + offsets.node);
            edge
        });
        SessionEntry {
            number,
            input: old.input.clone(),
            added: now.clone(),
            scans: old.scans,
            first_submap: old.first_submap + offsets.submap,
            last_submap: old.last_submap + offsets.submap,
            node_offset: old.node_offset + offsets.node,
            t_map_session: Some(StoredFrame(old.t_map_session.map_or(*t_map_added, |own| t_map_added * own.0))),
            loop_edges: moved.chain(own.map(Into::into)).collect(),
            run: old.run.clone(),
        }
    };
    added.iter().zip(last + 1..).map(session).collect()
}

/// When sessions are added; none where the clock shows no year of four digits.
fn now() -> Option<String> {
    const YEAR_10000: u64 = 253_402_300_800;
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok().filter(|since| since.as_secs() < YEAR_10000)?;
    Some(humantime::format_rfc3339_seconds(UNIX_EPOCH + since).to_string())
}
