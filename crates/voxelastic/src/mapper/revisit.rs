//! Detection of revisits: a scan taken where an earlier one was taken observes the same surfaces, and integration adds only what is new.
//!
//! Poses alone are no proof: before a loop is closed they may be wrong by the distance to the next aisle. So the path to the earlier scan has
//! to lead over a closed loop, or over an [overlap](crate::mapper::Assignment::Overlap), and be short.

use super::clusters::Clusters;
use crate::atlas::{Atlas, SubmapId};
use crate::event::NodeId;
use crate::geometry::{Pose, PoseExt};
use crate::settings::Settings;
use std::collections::{BTreeSet, HashSet};

/// A revisit in progress.
#[derive(Clone, Copy, Debug)]
struct Revisit {
    submap: SubmapId,
    /// Number of blocks of its TSDF when the revisit began.
    blocks: u32,
}

/// Detects revisits.
#[derive(Debug)]
pub(super) struct RevisitDetector {
    /// Largest distance to a scan of an earlier pass, metres; 0 for no detection.
    radius: f64,
    /// Range of the sensor, metres.
    max_range: f64,
    current: Option<Revisit>,
}

impl RevisitDetector {
    pub fn new(settings: &Settings) -> Self {
        Self { radius: settings.revisit_radius, max_range: f64::from(settings.max_range), current: None }
    }

    /// The submaps that observed the surroundings of `node` in an earlier pass; none unless a scan of that pass was taken within the radius
    /// and the path between both passes leaves the range of the sensor.
    pub fn revisited_submaps(&self, clusters: &Clusters, node: NodeId, t_map_lidar: &Pose) -> BTreeSet<SubmapId> {
        let Clusters { graph, assignments, .. } = clusters;
        if self.radius == 0.0 || !graph.has_loops() {
            return BTreeSet::new();
        }
        let same_pass: HashSet<NodeId> = graph.within_pass(node, 2.0 * self.max_range).into_iter().map(|(other, _)| other).collect();
        let mut earlier = graph.within(&[node], self.max_range);
        earlier.retain(|(other, _)| !same_pass.contains(other));
        let is_near = |other: NodeId| graph.pose(other).is_some_and(|pose| pose.translation_distance(t_map_lidar) <= self.radius);
        if !earlier.iter().any(|&(other, _)| is_near(other)) {
            return BTreeSet::new();
        }
        earlier.into_iter().filter_map(|(other, _)| assignments.submap_of(other)).collect()
    }

    /// Records that a scan that revisits `submaps` is integrated into submap `id`. Returns the number of TSDF blocks that the submap had
    /// when the revisit began: blocks with smaller ids are from earlier passes.
    pub fn blocks_before(&mut self, atlas: &Atlas, id: SubmapId, submaps: &BTreeSet<SubmapId>) -> u32 {
        if submaps.is_empty() {
            self.current = None;
            return 0;
        }
        let blocks = atlas.submap(id).map_or(0, |submap| submap.tsdf.ids().end);
        let revisit = self.current.filter(|revisit| revisit.submap == id).unwrap_or(Revisit { submap: id, blocks });
        self.current = Some(revisit);
        revisit.blocks
    }
}
