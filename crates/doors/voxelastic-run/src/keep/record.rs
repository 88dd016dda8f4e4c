//! What a journal holds of an event: all but the points, if they can be read again.

use serde::{Deserialize, Serialize};
use voxelastic::event::{Edge, Event, NodeId, Scan, Vertical};
use voxelastic::geometry::stored::StoredPose;
use voxelastic::{Cloud, Motion};

/// An event without points, or with those that the search for loop closures uses, if the input does not come again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Record {
    Scan { node: NodeId, time: f64, t_map_lidar: StoredPose, motion: Option<Motion>, points: Option<Vec<[f32; 3]>>, cloud: Option<Cloud> },
    OdometryEdge(Edge),
    LoopEdge(Edge),
    PoseUpdate(Vec<(NodeId, StoredPose)>),
    Vertical(Vertical),
}

impl Record {
    /// Of an event; none of kinds that are not known. The motion is stored where `with_motion` holds: where it is not in the input.
    pub(super) fn of(event: &Event, with_motion: bool) -> Option<Self> {
        Some(match event {
            Event::Scan(scan) => {
                let motion = scan.cloud.motion.clone().filter(|_| with_motion);
                Self::Scan { node: scan.node, time: scan.time, t_map_lidar: StoredPose(scan.t_map_lidar), motion, points: None, cloud: None }
            }
            Event::OdometryEdge(edge) => Self::OdometryEdge(edge.clone()),
            Event::LoopEdge(edge) => Self::LoopEdge(edge.clone()),
            Event::PoseUpdate(poses) => Self::PoseUpdate(poses.iter().map(|(node, pose)| (*node, StoredPose(*pose))).collect()),
            Event::Vertical(vertical) => Self::Vertical(*vertical),
            _ => return None,
        })
    }

    /// The event, with the points of a scan.
    pub(super) fn event(self, cloud: Cloud) -> Event {
        match self {
            Self::Scan { node, time, t_map_lidar: StoredPose(t_map_lidar), .. } => Event::Scan(Scan { node, time, t_map_lidar, cloud }),
            Self::OdometryEdge(edge) => Event::OdometryEdge(edge),
            Self::LoopEdge(edge) => Event::LoopEdge(edge),
            Self::PoseUpdate(poses) => Event::PoseUpdate(poses.into_iter().map(|(node, StoredPose(pose))| (node, pose)).collect()),
            Self::Vertical(vertical) => Event::Vertical(vertical),
        }
    }

    /// The scan with these points.
    pub(super) fn with_points(mut self, kept: &[[f32; 3]]) -> Self {
        if let Self::Scan { points, .. } = &mut self {
            *points = Some(kept.to_vec());
        }
        self
    }

    /// The scan with its whole cloud.
    pub(super) fn with_cloud(mut self, kept: &Cloud) -> Self {
        if let Self::Scan { cloud, .. } = &mut self {
            *cloud = Some(kept.clone());
        }
        self
    }

    /// The whole cloud of a scan, once, if it is kept.
    pub(super) fn take_cloud(&mut self) -> Option<(NodeId, Cloud)> {
        if let Self::Scan { node, cloud, .. } = self { cloud.take().map(|cloud| (*node, cloud)) } else { None }
    }

    /// The points of a scan, once, if they are kept.
    pub(super) fn take_points(&mut self) -> Option<Cloud> {
        if let Self::Scan { points, .. } = self { points.take().map(Cloud::from_points) } else { None }
    }

    /// The node of a scan.
    pub(super) fn node(&self) -> Option<NodeId> {
        if let Self::Scan { node, .. } = self { Some(*node) } else { None }
    }

    /// The motion during a scan, once.
    pub(super) fn take_motion(&mut self) -> Option<(NodeId, Motion)> {
        if let Self::Scan { node, motion, .. } = self { motion.take().map(|motion| (*node, motion)) } else { None }
    }

    pub(super) fn bytes(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_stdvec(self)
    }

    pub(super) fn read(bytes: &[u8]) -> Result<Self, String> {
        postcard::from_bytes(bytes).map_err(|e| format!("its journal: {e}"))
    }
}
