//! A run that did not end, as it was kept.

use super::identity::Identity;
use super::record::Record;
use super::state::RunState;
use crate::mapping::Mapping;
use crate::poses::{Came, Jumps, StageState};
use crate::warning::Warnings;
use crate::{Error, Result};
use std::collections::HashMap;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{Mapper, MapperState, ResumeError, ScanSource};
use voxelastic::sensor::BeamModel;
use voxelastic::settings::Settings;
use voxelastic::{Cloud, Motion};
use voxelastic_io::store::Checkpoint;
use voxelastic_io::{Origin, ReadPosition};
use voxelastic_report::RunLog;
use voxelastic_slam::Corrector;
use voxelastic_slam::loops::Searches;

/// A run that did not end, to be gone on with.
pub struct Unfinished {
    /// Where the reading of the input was, if it can be read again.
    pub position: Option<ReadPosition>,
    /// Of the odometry, if there was one.
    pub stage: Option<StageState>,
    /// The last position.
    pub jumps: Jumps,
    /// What the run had said.
    pub warnings: Warnings,
    /// Scans that came, while they came.
    pub came: Came,
    /// The log.
    log: RunLog,
    /// The origin of the map.
    pub origin: Origin,
    /// Outcomes of the searches for loop closures.
    pub searches: Option<Searches>,
    /// The edge of the voxels in which they were looked for, metres.
    pub loop_voxel_m: Option<f64>,
    /// What the mapper knows beside the atlas.
    mapper: MapperState<'static>,
    /// The submaps.
    atlas: Atlas,
    records: Vec<Record>,
}

impl Unfinished {
    pub(super) fn read(found: Checkpoint) -> std::result::Result<Self, String> {
        let (_, state) = Identity::split(&found.state)?;
        let RunState { position, stage, jumps, warnings, came, log, origin, searches, loop_voxel_m, mapper } =
            postcard::from_bytes(state).map_err(|e| format!("its state: {e}"))?;
        let origin = Origin::new(origin).ok_or("its origin is no place")?;
        let records = found.records.iter().map(|bytes| Record::read(bytes)).collect::<std::result::Result<_, _>>()?;
        Ok(Self {
            position,
            stage,
            jumps: jumps.into_owned(),
            warnings: warnings.into_owned(),
            came,
            log: log.whole(),
            origin,
            searches,
            loop_voxel_m,
            mapper,
            atlas: found.atlas,
            records,
        })
    }

    /// Motions of the lidar during sweeps that the run has found.
    pub fn motions(&mut self) -> impl Iterator<Item = (NodeId, Motion)> {
        self.records.iter_mut().filter_map(Record::take_motion)
    }

    /// Scans that were mapped.
    pub fn scans(&self) -> usize {
        self.atlas.scan_count()
    }

    /// Shows `corrector` all that the one of the run has seen. Clouds are read again where it looks for loop closures.
    fn bring_up(&mut self, corrector: &mut Corrector, clouds: &mut (dyn ScanSource + Send)) -> Result<()> {
        if corrector.is_idle() {
            return Ok(());
        }
        let looks = self.searches.is_some();
        for mut record in std::mem::take(&mut self.records) {
            let kept = record.take_points();
            let cloud = match record.node().filter(|_| looks && kept.is_none()) {
                Some(node) => clouds.cloud(node).map_err(|problem| {
                    Error::new(format!("the scan of node {node} cannot be read again: {problem}"), "--restart maps from the beginning")
                })?,
                None => kept.unwrap_or_default(),
            };
            let event: Event = record.event(cloud);
            // What could not be used then cannot be used now.
            let _ = corrector.take(event);
        }
        Ok(())
    }

    /// The first clouds of its sensors, if they do not come again.
    pub fn clouds(&mut self) -> KeptClouds {
        KeptClouds(self.records.iter_mut().filter_map(Record::take_cloud).collect())
    }

    /// The mapper of the run with its log, and `corrector` brought to where its was. `clouds` reads those of before again.
    ///
    /// # Errors
    /// When one of them cannot be read, or the settings are out of range.
    pub fn mapping(
        mut self,
        settings: &Settings,
        sensor: Option<BeamModel>,
        clouds: &mut (dyn ScanSource + Send),
        corrector: &mut Corrector,
        pool: rayon::ThreadPool,
    ) -> Result<Mapping> {
        pool.install(|| self.bring_up(corrector, clouds))?;
        let Self { log, mapper, atlas, .. } = self;
        let resumed = pool.install(|| Mapper::resume(settings.clone(), sensor, mapper, atlas, clouds));
        let mapper = resumed.map_err(|error| match error {
            ResumeError::Settings(error) => Error::from(error),
            other => Error::new(format!("cannot go on with the run that did not end: {other}"), "--restart maps from the beginning"),
        })?;
        Ok(Mapping::new(mapper, pool, Some(log)))
    }

    /// The run as other scans go on with it, that come later.
    #[must_use]
    pub fn for_other_scans(self) -> Self {
        Self { mapper: self.mapper.for_other_scans(), ..self }
    }

    /// The node that came last, and a number for the next one.
    pub fn nodes(&self) -> (Option<NodeId>, NodeId) {
        (self.mapper.last_node(), self.mapper.next_node())
    }
}

/// The first clouds of sensors, kept because scans do not come again.
pub struct KeptClouds(HashMap<NodeId, Cloud>);

impl KeptClouds {
    /// The sensors.
    pub fn sensors(&self) -> impl Iterator<Item = u16> + '_ {
        self.0.values().map(|cloud| cloud.sensor)
    }
}

impl ScanSource for KeptClouds {
    fn cloud(&mut self, node: NodeId) -> std::result::Result<Cloud, Box<dyn std::error::Error + Send + Sync>> {
        self.0.get(&node).cloned().ok_or_else(|| "scans that a program or a robot delivered are not kept".into())
    }
}
