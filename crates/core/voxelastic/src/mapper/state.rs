//! What a mapper knows beside its atlas, so that another process can go on where this one is.
//!
//! The fields of submaps are stored as those of a map are. The state is the rest: the pose graph, the assignments, the fusions that are due, the
//! revisit in progress, and what a stored submap does not have. A mapper that was resumed makes the same map, bit for bit, as one that never
//! stopped.

use super::background_fusion::FusionSchedule;
use super::moving::{Cells, MovingState};
use super::pipeline::Mapper;
use super::rebuild::ScanSource;
use super::report::ElasticCounts;
use super::revisit::RevisitState;
use super::sensors::Sensor;
use crate::Cloud;
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Atlas, NodeAssignments, SubmapId};
use crate::event::NodeId;
use crate::field::tsdf::ObservationCount;
use crate::sensor::BeamModel;
use crate::settings::{SettingError, Settings};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::sync::Arc;

/// What a [`Mapper`] knows beside its atlas, between two events; see [`Mapper::state`].
///
/// Its serialised form belongs to the version of the program that wrote it. What grows with the run is borrowed from the mapper, so that taking a state and
/// serialising it needs hardly any memory.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MapperState<'a> {
    graph: Cow<'a, PoseGraph>,
    assignments: Cow<'a, NodeAssignments>,
    size_limited: Vec<(Vec<SubmapId>, [NodeId; 2])>,
    fusions: FusionSchedule,
    revisit: Option<RevisitState>,
    /// Each sensor, with the node whose cloud showed which it is.
    sensors: Vec<(u16, NodeId, MovingState)>,
    last_node: Option<NodeId>,
    counts: ElasticCounts,
    next_submap: SubmapId,
    /// Where laps are kept apart, the first submap of this one.
    lap: Option<SubmapId>,
    /// By submap, the observation counts of the blocks of its TSDF in Morton order.
    observed: Vec<(SubmapId, Vec<u8>)>,
}

impl MapperState<'_> {
    /// The state for scans that come later and from elsewhere, where those before cannot be read again: sensors are recognised from the next scans,
    /// what moves is looked for from there on, and no revisit is in progress.
    #[must_use]
    pub fn for_other_scans(self) -> Self {
        Self { sensors: Vec::new(), revisit: None, lap: None, ..self }
    }

    /// The node that came last.
    pub fn last_node(&self) -> Option<NodeId> {
        self.last_node
    }

    /// A number that no node of the state has or waits for, and none above it.
    pub fn next_node(&self) -> NodeId {
        self.graph.next_node()
    }
}

/// Why a mapper cannot go on from a state.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ResumeError {
    /// The settings are out of range.
    #[error(transparent)]
    Settings(#[from] SettingError),
    /// The submaps are not those that the mapper had.
    #[error("submap {submap} is not what it was when the state was stored")]
    OtherSubmap {
        /// The submap.
        submap: SubmapId,
    },
    /// A scan with which the next ones are compared could not be read again.
    #[error("the scan of node {node}, with which the next scans are compared to find what moves, cannot be read again")]
    Scan {
        /// Its node.
        node: NodeId,
        /// The cause.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The scan that showed which sensor it is could not be read again.
    #[error("the scan of node {node}, which shows what sensor it is, cannot be read again")]
    Sensor {
        /// Its node.
        node: NodeId,
        /// The cause.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl Mapper {
    /// What the mapper knows beside its [atlas](Self::atlas). None while a fusion is in progress: it ends some scans later. Fusions that are
    /// due do not hinder.
    pub fn state(&self) -> Option<MapperState<'_>> {
        let fusions = self.fusion.schedule()?.clone();
        let observed = |field: &crate::field::tsdf::TsdfField| {
            field.ids_in_morton_order().into_iter().map(|id| field.block(id).observation_count.bits()).collect()
        };
        Some(MapperState {
            graph: Cow::Borrowed(&self.clusters.graph),
            assignments: Cow::Borrowed(&self.clusters.assignments),
            size_limited: self.clusters.size_limited.iter().map(|(submaps, ends)| (submaps.clone(), *ends)).collect(),
            fusions,
            revisit: self.revisits.state(&self.atlas),
            sensors: self.sensors.iter().map(|(index, sensor)| (index, sensor.first_node, sensor.moving.state())).collect(),
            last_node: self.last_node,
            counts: self.counts,
            next_submap: self.atlas.next_id(),
            lap: self.lap,
            observed: self.atlas.submaps().iter().map(|submap| (submap.id, observed(&submap.tsdf))).collect(),
        })
    }

    /// A mapper that goes on from `state`, with the settings and the sensor model of the one that the state was taken of. `atlas` has the
    /// submaps that this one had then, as a map stores them; `scans` reads the first scan of each sensor again, to recognise it, and where things that move are removed
    /// the scans with which the next ones are compared.
    ///
    /// # Errors
    /// [`ResumeError`].
    pub fn resume(
        settings: Settings,
        sensor_model: Option<BeamModel>,
        state: MapperState<'_>,
        mut atlas: Atlas,
        scans: &mut dyn ScanSource,
    ) -> Result<Self, ResumeError> {
        let mut mapper = Self::new(settings)?;
        mapper.sensor_model = sensor_model;
        for (index, node, moving) in state.sensors {
            let cannot_read = |source| ResumeError::Sensor { node, source };
            let cloud = Cloud { sensor: index, ..scans.cloud(node).map_err(cannot_read)? };
            let opened = mapper.sensors.of(&mapper.settings, mapper.sensor_model.as_ref(), &cloud, node);
            let Sensor { frontend, moving: detector, .. } = opened.map_err(|error| cannot_read(Box::new(error)))?;
            let model = frontend.model().clone();
            *detector = moving.detector(&model, |node| -> Result<Arc<Cells>, ResumeError> {
                let cloud = scans.cloud(node).map_err(|source| ResumeError::Scan { node, source })?;
                Ok(Arc::new(Cells::new(frontend.prepare(&cloud).fit_planes())))
            })?;
        }
        for (submap, counts) in state.observed {
            let other = ResumeError::OtherSubmap { submap };
            let Some(found) = atlas.submap_mut(submap) else { return Err(other) };
            let ids = found.tsdf.ids_in_morton_order();
            if ids.len() != counts.len() {
                return Err(other);
            }
            for (id, bits) in ids.into_iter().zip(counts) {
                found.tsdf.blocks[id].observation_count = ObservationCount::from_bits(bits);
            }
        }
        atlas.skip_ids(state.next_submap);
        let submap = state.revisit.as_ref().map_or(0, RevisitState::submap);
        mapper.revisits.resume(state.revisit, &atlas).ok_or(ResumeError::OtherSubmap { submap })?;
        mapper.clusters.graph = state.graph.into_owned();
        mapper.clusters.assignments = state.assignments.into_owned();
        mapper.clusters.size_limited = state.size_limited.into_iter().collect();
        mapper.fusion.set_schedule(state.fusions);
        (mapper.last_node, mapper.counts, mapper.lap) = (state.last_node, state.counts, state.lap);
        mapper.conflicts_resolved = false;
        mapper.atlas = atlas;
        Ok(mapper)
    }

    /// A mapper that goes on in a saved map, of which nothing is left but its submaps. Its nodes have the poses that they have in the map, and hang together in the order
    /// of their numbers; loop edges of before are not known, so nothing of before is fused any more unless loops close anew. Scans that come continue where the
    /// node with the highest number was, or in submaps that contain them; their nodes need numbers from [`next_node`](Self::next_node) on.
    ///
    /// # Errors
    /// Settings out of range. Voxel size and field must be those of the map: the caller compares them.
    pub fn in_saved(settings: Settings, sensor_model: Option<BeamModel>, atlas: Atlas) -> Result<Self, SettingError> {
        let mut mapper = Self::new(settings)?;
        mapper.sensor_model = sensor_model;
        let mut poses = Vec::new();
        for submap in atlas.submaps() {
            // The first scan of a submap is its root.
            submap.scans().iter().for_each(|scan| mapper.clusters.assignments.add(scan.node, submap.id));
            poses.extend(submap.corrected_scans().map(|(node, t_submap_lidar)| (node, submap.t_map_submap() * t_submap_lidar)));
        }
        poses.sort_by_key(|(node, _)| *node);
        for (node, t_map_lidar) in poses {
            mapper.clusters.graph.add_node(node, &t_map_lidar);
            if let Some(last) = mapper.last_node.replace(node) {
                mapper.clusters.graph.assume_odometry(last, node);
            }
        }
        mapper.atlas = atlas;
        Ok(mapper)
    }

    /// The node that came last.
    pub fn last_node(&self) -> Option<NodeId> {
        self.last_node
    }

    /// A number that no node has or waits for, and none above it.
    pub fn next_node(&self) -> NodeId {
        self.clusters.graph.next_node()
    }
}
