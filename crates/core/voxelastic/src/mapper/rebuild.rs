//! Rebuilding a submap from its scans: a rigid submap cannot follow corrections between its own nodes, its scans can.

use super::integrators::Integrators;
use super::moving::MovingDetector;
use super::sensors::Sensors;
use crate::Cloud;
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Submap, SubmapId};
use crate::event::NodeId;
use crate::integrate::Redundancy;
use crate::sensor::BeamModel;
use crate::settings::{Dynamic, Settings};
use std::collections::BTreeMap;

/// Reads the clouds of scans that were mapped before.
pub trait ScanSource {
    /// The cloud taken at `node`.
    ///
    /// # Errors
    /// Whatever prevents reading it; the submap is unchanged then.
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn std::error::Error + Send + Sync>>;
}

/// Report about a rebuilt submap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct RebuildReport {
    /// Number of scans integrated.
    pub scans: usize,
    /// Memory of the submap's fields before, bytes.
    pub bytes_before: usize,
    /// Memory of the submap's fields now, bytes.
    pub bytes_after: usize,
}

/// Why a submap was not rebuilt. It is unchanged.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RebuildError {
    /// There is no such submap.
    #[error("there is no submap {submap}")]
    NoSuchSubmap {
        /// Its id.
        submap: SubmapId,
    },
    /// A scan could not be read.
    #[error("submap {submap} cannot be rebuilt: the scan of node {node} cannot be read")]
    Scan {
        /// The submap.
        submap: SubmapId,
        /// The scan's node.
        node: NodeId,
        /// The cause.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// What a rebuild needs of the mapper.
pub(super) struct Rebuilder<'a> {
    pub settings: &'a Settings,
    pub graph: &'a PoseGraph,
    pub sensor_model: Option<&'a BeamModel>,
    pub sensors: &'a mut Sensors,
    pub integrators: &'a mut Integrators,
}

impl Rebuilder<'_> {
    /// A submap from the scans of `old` at the current poses of their nodes, and the number of scans integrated.
    pub fn rebuild(&mut self, old: &Submap, source: &mut dyn ScanSource) -> Result<(Submap, usize), RebuildError> {
        let id = old.id;
        let root = old.root_node().and_then(|root| self.graph.pose(root)).copied().unwrap_or(old.t_map_submap);
        let mut new = Submap { revision: old.revision + 1, ..Submap::new(id, old.voxel_size, root) };
        let (mut scans, mut moving) = (0, BTreeMap::<u16, MovingDetector>::new());
        for scan in &old.scans {
            let node = scan.node;
            let cloud = source.cloud(node).map_err(|source| RebuildError::Scan { submap: id, node, source })?;
            let t_submap_lidar = self.graph.pose(node).map_or(scan.t_submap_lidar, |pose| root.inv_mul(pose));
            let sensor = self.sensors.of(self.settings, self.sensor_model, &cloud, node);
            let sensor = sensor.map_err(|error| RebuildError::Scan { submap: id, node, source: Box::new(error) })?;
            let mut prepared = sensor.frontend.prepare(&cloud);
            new.add_scan_at(node, t_submap_lidar);
            prepared.fit_planes_for_map(self.settings);
            if !prepared.scan().returns.is_empty() {
                let mut moves = Vec::new();
                if self.settings.dynamic == Dynamic::Remove {
                    let moving = moving.entry(cloud.sensor).or_default();
                    if moving.submap().is_none() {
                        moving.enter(id, None);
                    }
                    moves = moving.judge(&t_submap_lidar, prepared.scan(), prepared.model());
                    moving.remember(node, &t_submap_lidar, None, prepared.scan(), prepared.model());
                }
                self.integrators.integrate(cloud.sensor, &mut new, &t_submap_lidar, &prepared.without(&moves), self.settings, &Redundancy::default());
                scans += 1;
            }
        }
        new.tsdf.compact_all();
        Ok((new, scans))
    }
}
