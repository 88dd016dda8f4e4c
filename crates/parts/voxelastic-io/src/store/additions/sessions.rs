//! The sessions that a map was made of.
//!
//! Each has submaps of its own, whose numbers follow each other. So one that is taken out leaves the others as they were, bit for bit.

use crate::store::description::pose_as_numbers;
use serde::{Deserialize, Serialize};
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::event::{Edge, NodeId};

/// A session in the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionEntry {
    /// Its number, from 1. It stays when others are taken out.
    pub number: u32,
    /// The data that it was mapped from, as it was named; absent where nobody knows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<String>,
    /// When it was added, UTC: `2026-11-25T06:00:00Z`; absent for the session that the map began with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub added: Option<String>,
    /// Number of its scans when it was added.
    pub scans: usize,
    /// Its first and last submap. Not every number in between need be there.
    pub first_submap: SubmapId,
    /// The last.
    pub last_submap: SubmapId,
    /// What was added to the numbers of its nodes, so that no two sessions have the same.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub node_offset: NodeId,
    /// Where its own frame lies in that of the map; absent for the session that the map began with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_map_session: Option<StoredFrame>,
    /// Loop edges from nodes of earlier sessions to nodes of this one, by which its poses were corrected.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub loop_edges: Vec<StoredEdge>,
    /// A number that tells the run that mapped it, with its settings and data, from others; absent where nobody knows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
}

/// A pose in the manifest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct StoredFrame(#[serde(with = "pose_as_numbers")] pub Pose);

/// An edge of the pose graph in the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredEdge {
    /// Node of an earlier session.
    pub from: NodeId,
    /// Node of this session.
    pub to: NodeId,
    /// Pose of `to` in the frame of `from`.
    #[serde(with = "pose_as_numbers")]
    pub t_from_to: Pose,
    /// Information matrix, upper triangle row by row (x y z roll pitch yaw).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub information: Vec<f64>,
}

impl From<&Edge> for StoredEdge {
    fn from(edge: &Edge) -> Self {
        let information = edge.information.map_or_else(Vec::new, |numbers| numbers.to_vec());
        Self { from: edge.from, to: edge.to, t_from_to: edge.t_from_to, information }
    }
}

impl SessionEntry {
    /// Whether submap `id` is one of its.
    pub fn has(&self, id: SubmapId) -> bool {
        (self.first_submap..=self.last_submap).contains(&id)
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde wants it so")]
fn is_zero(number: &NodeId) -> bool {
    *number == 0
}

/// Whether a list of sessions is one that a writer makes; else what is wrong with it.
pub(crate) fn check(sessions: &[SessionEntry]) -> Result<(), String> {
    if let Some(pair) = sessions.windows(2).find(|pair| pair[0].number >= pair[1].number) {
        return Err(format!("session {} comes twice or too late", pair[1].number));
    }
    match sessions.iter().find(|session| session.first_submap > session.last_submap) {
        Some(session) => Err(format!("session {} ends before it begins", session.number)),
        None => Ok(()),
    }
}
