//! A submap: its fields, its root pose and the scans it was made from.

use crate::event::NodeId;
use crate::field::occupancy::OccupancyField;
use crate::field::tsdf::TsdfField;
use crate::geometry::{Pose, PoseExt};

/// Identifier of a submap, unique within an atlas and never used again.
pub type SubmapId = u32;

/// A scan that a submap was made from.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapScan {
    /// The pose-graph node where it was taken.
    pub node: NodeId,
    /// Where it was integrated: pose of the lidar in the submap's frame.
    pub t_submap_lidar: Pose,
}

/// A rigid piece of the map (paper Sec. IV): fields in the submap frame S, placed by the root pose.
#[derive(Clone, Debug)]
pub struct Submap {
    /// Its identifier.
    pub id: SubmapId,
    /// Root pose: the submap frame in the map frame. The only thing that a pose correction changes.
    pub t_map_submap: Pose,
    /// The scans it was made from, in the order in which they were integrated.
    pub scans: Vec<SubmapScan>,
    /// The TSDF, if the map has that field.
    pub tsdf: TsdfField,
    /// Free, occupied and unknown space, if the map has that field.
    pub occupancy: OccupancyField,
    /// Path length from the root pose to the last scan, metres.
    pub travelled: f64,
    /// Counts the changes of the fields, so that whatever was made from them knows whether it is out of date. Not stored.
    pub revision: u64,
}

impl Submap {
    /// An empty submap at `t_map_submap`.
    pub fn new(id: SubmapId, t_map_submap: Pose) -> Self {
        let (tsdf, occupancy) = (TsdfField::default(), OccupancyField::default());
        Self { id, t_map_submap, scans: Vec::new(), tsdf, occupancy, travelled: 0.0, revision: 0 }
    }

    /// Notes that the scan of `node`, taken at `t_map_lidar`, was integrated; returns its pose in the submap.
    pub fn add_scan(&mut self, node: NodeId, t_map_lidar: &Pose) -> Pose {
        let t_submap_lidar = self.t_map_submap.inv_mul(t_map_lidar);
        self.place_scan(node, t_submap_lidar);
        t_submap_lidar
    }

    /// Notes that the scan of `node` was integrated at `t_submap_lidar`.
    pub fn place_scan(&mut self, node: NodeId, t_submap_lidar: Pose) {
        self.travelled += self.scans.last().map_or(0.0, |last| last.t_submap_lidar.translation_distance(&t_submap_lidar));
        self.scans.push(SubmapScan { node, t_submap_lidar });
        self.revision += 1;
    }

    /// The node whose pose is the root pose; none before the first scan.
    pub fn root_node(&self) -> Option<NodeId> {
        self.scans.first().map(|s| s.node)
    }

    /// Bytes that the fields hold.
    pub fn bytes(&self) -> usize {
        self.tsdf.bytes() + self.occupancy.bytes()
    }
}
