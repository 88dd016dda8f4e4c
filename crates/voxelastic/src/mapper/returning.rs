//! Where the sensor has been before: a scan taken there sees what an earlier one saw, and adds to surfaces only what is new.
//!
//! Poses alone do not prove it: before a loop is closed they may lie about as far off as the next aisle. So the way to the earlier scan has to lead
//! over a closed loop, or over an [overlap](super::Placed::Overlap), and be short.

use super::{Mapper, Visit};
use crate::atlas::SubmapId;
use crate::event::NodeId;
use crate::geometry::{Pose, PoseExt};
use std::collections::{BTreeSet, HashSet};

impl Mapper {
    /// The submaps that know the place of `node` from an earlier pass, one that left what can be seen from there since: none unless it took a scan
    /// within `revisit_radius`.
    pub(super) fn returned_to(&self, node: NodeId, t_map_lidar: &Pose) -> BTreeSet<SubmapId> {
        let (radius, range) = (self.settings.revisit_radius, f64::from(self.settings.max_range));
        if radius == 0.0 || !self.graph.has_loops() {
            return BTreeSet::new();
        }
        let along: HashSet<NodeId> = self.graph.within_pass(node, 2.0 * range).into_iter().map(|(other, _)| other).collect();
        let mut earlier = self.graph.within(&[node], range);
        earlier.retain(|(other, _)| !along.contains(other));
        let is_near = |other: NodeId| self.graph.pose(other).is_some_and(|pose| pose.translation_distance(t_map_lidar) <= radius);
        if !earlier.iter().any(|&(other, _)| is_near(other)) {
            return BTreeSet::new();
        }
        earlier.into_iter().filter_map(|(other, _)| self.members.submap_of(other)).collect()
    }

    /// Notes that a scan goes into submap `id`, where the sensor has returned to `submaps`. Tells which blocks of its TSDF were there before.
    pub(super) fn visit(&mut self, id: SubmapId, submaps: &BTreeSet<SubmapId>) -> u32 {
        if submaps.is_empty() {
            self.visit = None;
            return 0;
        }
        let blocks = self.atlas.submap(id).map_or(0, |submap| submap.tsdf.ids().end);
        let visit = self.visit.filter(|visit| visit.submap == id).unwrap_or(Visit { submap: id, blocks });
        self.visit = Some(visit);
        visit.blocks
    }
}
