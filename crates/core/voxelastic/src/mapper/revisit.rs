//! Detection of revisits: a scan taken where an earlier one was taken observes the same surfaces, and integration adds only what is new.
//!
//! Poses alone are no proof: before a loop is closed they may be wrong by the distance to the next aisle. So the path to the earlier scan has
//! to lead over a closed loop, or over an [overlap](crate::mapper::Assignment::Overlap), and be short.

use super::clusters::Clusters;
use crate::atlas::{Atlas, NodeSet, SubmapId};
use crate::event::NodeId;
use crate::geometry::{Pose, PoseExt};
use crate::integrate::EarlierBlocks;
use crate::settings::{Laps, Settings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A revisit in progress.
#[derive(Clone, Debug)]
struct Revisit {
    submap: SubmapId,
    /// Number of blocks of its TSDF when the revisit began, or when it was loaded after that.
    blocks: u32,
    /// By id, blocks that it had when it was loaded, but not when the revisit began.
    later: Vec<bool>,
}

impl Revisit {
    fn earlier(&self) -> EarlierBlocks<'_> {
        EarlierBlocks { end: self.blocks, later: &self.later }
    }
}

/// A revisit in progress, in a form that does not depend on the ids of blocks.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct RevisitState {
    submap: SubmapId,
    /// In Morton order, whether each block of the submap's TSDF came after the revisit began.
    later: Vec<bool>,
}

impl RevisitState {
    /// The submap that is revisited.
    pub fn submap(&self) -> SubmapId {
        self.submap
    }
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
        // A lap that is kept apart needs all that it sees.
        let radius = if settings.laps == Laps::Apart { 0.0 } else { settings.revisit_radius };
        Self { radius, max_range: f64::from(settings.max_range), current: None }
    }

    /// The submaps that observed the surroundings of `node` in an earlier pass; none unless a scan of that pass was taken within the radius
    /// and the path between both passes leaves the range of the sensor.
    pub fn revisited_submaps(&self, clusters: &Clusters, node: NodeId, t_map_lidar: &Pose) -> BTreeSet<SubmapId> {
        let Clusters { graph, assignments, .. } = clusters;
        if self.radius == 0.0 || !graph.has_loops() {
            return BTreeSet::new();
        }
        let same_pass: NodeSet = graph.within_pass(node, 2.0 * self.max_range).into_iter().map(|(other, _)| other).collect();
        let mut earlier = graph.within(&[node], self.max_range);
        earlier.retain(|(other, _)| !same_pass.contains(other));
        let is_near = |other: NodeId| graph.pose(other).is_some_and(|pose| pose.translation_distance(t_map_lidar) <= self.radius);
        if !earlier.iter().any(|&(other, _)| is_near(other)) {
            return BTreeSet::new();
        }
        earlier.into_iter().filter_map(|(other, _)| assignments.submap_of(other)).collect()
    }

    /// Records that a scan that revisits `submaps` is integrated into submap `id`. Returns the TSDF blocks that the submap had
    /// when the revisit began: those of earlier passes.
    pub fn blocks_before(&mut self, atlas: &Atlas, id: SubmapId, submaps: &BTreeSet<SubmapId>) -> EarlierBlocks<'_> {
        if submaps.is_empty() {
            self.current = None;
            return EarlierBlocks::default();
        }
        let blocks = atlas.submap(id).map_or(0, |submap| submap.tsdf.ids().end);
        let current = self.current.take().filter(|revisit| revisit.submap == id);
        self.current.insert(current.unwrap_or(Revisit { submap: id, blocks, later: Vec::new() })).earlier()
    }

    /// Forgets a revisit of a submap whose blocks are other ones now.
    pub fn forget(&mut self, id: SubmapId) {
        self.current = self.current.take().filter(|revisit| revisit.submap != id);
    }

    /// The revisit in progress, to go on with it later.
    pub fn state(&self, atlas: &Atlas) -> Option<RevisitState> {
        let revisit = self.current.as_ref()?;
        let field = &atlas.submap(revisit.submap)?.tsdf;
        let later = field.ids_in_morton_order().into_iter().map(|id| !revisit.earlier().contains(id)).collect();
        Some(RevisitState { submap: revisit.submap, later })
    }

    /// Goes on with a revisit, in submaps that were loaded; `None` if they are not those of the state.
    pub fn resume(&mut self, state: Option<RevisitState>, atlas: &Atlas) -> Option<()> {
        self.current = match state {
            None => None,
            Some(RevisitState { submap, later: in_order }) => {
                let ids = atlas.submap(submap)?.tsdf.ids_in_morton_order();
                let mut later = vec![false; ids.len()];
                let is_whole = ids.len() == in_order.len();
                ids.into_iter().zip(in_order).for_each(|(id, is_later)| later[id as usize] = is_later);
                is_whole.then_some(Some(Revisit { submap, blocks: later.len() as u32, later }))?
            }
        };
        Some(())
    }
}
