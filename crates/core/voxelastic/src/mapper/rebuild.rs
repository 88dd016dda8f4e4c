//! Rebuilding a submap from its scans: a rigid submap cannot follow corrections between its own nodes, its scans can.

use super::correct::correct_scans;
use super::moving::MovingDetector;
use super::pipeline::Mapper;
use crate::Cloud;
use crate::atlas::{Submap, SubmapId, SubmapScan};
use crate::event::NodeId;
use crate::integrate::Redundancy;
use crate::settings::Dynamic;
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
    /// Its scans are other ones now: submaps were fused meanwhile.
    #[error("submap {submap} was fused with another while it was rebuilt")]
    Fused {
        /// The submap.
        submap: SubmapId,
    },
}

/// Changes that a rebuild counts for: a revision and the number of scans of a field grow together otherwise, by which those who watch a field know that it only grew.
const CHANGES: u64 = 1 << 20;

/// A submap that is being rebuilt, a scan at a time, while the mapper goes on with other events. It takes the place of the old one once it has all of its scans.
#[derive(Debug)]
pub struct Rebuilding {
    new: Submap,
    /// The scans of the old submap, each where corrections have put it.
    scans: Vec<SubmapScan>,
    /// Those of them that had returns.
    used: usize,
    moving: BTreeMap<u16, MovingDetector>,
}

impl Rebuilding {
    /// The submap.
    pub fn submap(&self) -> SubmapId {
        self.new.id
    }

    /// Scans that are still to be integrated, as far as it is known.
    pub fn remaining(&self) -> usize {
        self.scans.len() - self.new.scans.len()
    }
}

impl Mapper {
    /// Rebuilds submap `id` from its scans at the current poses of their nodes, after completing all fusions. Its conflicts with other
    /// submaps are resolved by the next [`finish`](Self::finish).
    ///
    /// # Errors
    /// [`RebuildError`]; the submap is unchanged.
    pub fn rebuild(&mut self, id: SubmapId, source: &mut dyn ScanSource) -> Result<RebuildReport, RebuildError> {
        self.finish_fusions();
        let mut rebuilding = self.begin_rebuild(id)?;
        loop {
            if let Some(report) = self.step_rebuild(&mut rebuilding, source)? {
                return Ok(report);
            }
        }
    }

    /// Begins to rebuild submap `id`, which stays as it is until [`step_rebuild`](Self::step_rebuild) has done all of it.
    ///
    /// # Errors
    /// [`RebuildError::NoSuchSubmap`].
    pub fn begin_rebuild(&self, id: SubmapId) -> Result<Rebuilding, RebuildError> {
        let old = self.atlas.submap(id).ok_or(RebuildError::NoSuchSubmap { submap: id })?;
        let root = old.root_node().and_then(|root| self.clusters.graph.pose(root)).copied().unwrap_or(old.t_map_submap);
        let scans = self.corrected_scans(old, 0);
        Ok(Rebuilding { new: Submap::new(id, old.voxel_size, root), scans, used: 0, moving: BTreeMap::new() })
    }

    /// The scans of a submap from the `first` on, each where the graph has its node now.
    fn corrected_scans(&self, submap: &Submap, first: usize) -> Vec<SubmapScan> {
        let graph = &self.clusters.graph;
        let root = submap.root_node().and_then(|root| graph.pose(root)).copied().unwrap_or(submap.t_map_submap);
        let corrected = |scan: &SubmapScan| SubmapScan {
            node: scan.node,
            t_submap_lidar: graph.pose(scan.node).map_or(scan.t_submap_lidar, |pose| root.inv_mul(pose)),
        };
        submap.scans.iter().skip(first).map(corrected).collect()
    }

    /// Integrates the next scan into a submap that is being rebuilt. Once it has all scans, those of the old one that came meanwhile included, it takes its place, all
    /// fusions are completed, and there is a report. What was corrected meanwhile is for another rebuild.
    ///
    /// # Errors
    /// [`RebuildError`]; the old submap is unchanged, and the rebuild cannot go on.
    pub fn step_rebuild(&mut self, rebuilding: &mut Rebuilding, source: &mut dyn ScanSource) -> Result<Option<RebuildReport>, RebuildError> {
        if let Some(scan) = rebuilding.scans.get(rebuilding.new.scans.len()).cloned() {
            self.integrate_again(rebuilding, &scan, source)?;
        }
        if rebuilding.remaining() > 0 {
            return Ok(None);
        }
        self.finish_fusions();
        let id = rebuilding.submap();
        let old = self.atlas.submap(id).ok_or(RebuildError::NoSuchSubmap { submap: id })?;
        let is_same = old.scans.iter().map(|scan| scan.node).take(rebuilding.scans.len()).eq(rebuilding.scans.iter().map(|scan| scan.node));
        if !is_same {
            return Err(RebuildError::Fused { submap: id });
        }
        let more = self.corrected_scans(old, rebuilding.scans.len());
        rebuilding.scans.extend(more);
        if rebuilding.remaining() > 0 {
            return Ok(None);
        }
        Ok(Some(self.put_in_place(rebuilding)))
    }

    fn integrate_again(&mut self, rebuilding: &mut Rebuilding, scan: &SubmapScan, source: &mut dyn ScanSource) -> Result<(), RebuildError> {
        let (Self { settings, sensors, sensor_model, integrators, .. }, Rebuilding { new, used, moving, .. }) = (self, rebuilding);
        let (node, submap, t_submap_lidar) = (scan.node, new.id, &scan.t_submap_lidar);
        let cloud = source.cloud(node).map_err(|source| RebuildError::Scan { submap, node, source })?;
        let sensor = sensors.of(settings, sensor_model.as_ref(), &cloud, node);
        let sensor = sensor.map_err(|error| RebuildError::Scan { submap, node, source: Box::new(error) })?;
        let mut prepared = sensor.frontend.prepare(&cloud);
        new.add_scan_at(node, *t_submap_lidar);
        prepared.fit_planes_for_map(settings);
        if prepared.scan().returns.is_empty() {
            return Ok(());
        }
        let mut moves = Vec::new();
        if settings.dynamic == Dynamic::Remove {
            let moving = moving.entry(cloud.sensor).or_default();
            if moving.submap().is_none() {
                moving.enter(submap, None);
            }
            moves = moving.judge(t_submap_lidar, prepared.scan(), prepared.model());
            moving.remember(node, t_submap_lidar, None, prepared.scan(), prepared.model());
        }
        integrators.integrate(cloud.sensor, new, t_submap_lidar, &prepared.without(&moves), settings, &Redundancy::default());
        *used += 1;
        Ok(())
    }

    fn put_in_place(&mut self, rebuilding: &mut Rebuilding) -> RebuildReport {
        let id = rebuilding.submap();
        let mut new = std::mem::replace(&mut rebuilding.new, Submap::new(id, self.atlas.voxel_size(), crate::Pose::identity()));
        new.tsdf.compact_all();
        let mut report = RebuildReport { scans: rebuilding.used, bytes_before: 0, bytes_after: new.bytes() };
        let root = new.root_node().and_then(|root| self.clusters.graph.pose(root)).copied();
        if let Some(old) = self.atlas.submap_mut(id) {
            report.bytes_before = old.bytes();
            (new.revision, new.t_map_submap) = (old.revision + CHANGES, root.unwrap_or(new.t_map_submap));
            *old = new;
        }
        correct_scans(&mut self.atlas, &self.clusters.graph);
        self.conflicts_resolved = false;
        self.sensors.iter_mut().for_each(|sensor| sensor.moving.forget(id));
        self.revisits.forget(id);
        self.counts.rebuilds += 1;
        report
    }
}
