//! The mapper: events in, an elastic atlas out. One path for live and replayed input (paper Fig. 4).
//!
//! [`Mapper::handle`] takes each [`Event`] as it happens. A scan is prepared (range image, local planes), assigned to a
//! submap, and integrated into the submap's fields in the submap's frame.

mod front;
mod report;

pub use front::Front;
pub use report::{MapError, ScanReport};

use crate::atlas::{Atlas, SubmapId};
use crate::event::{Event, NodeId, Scan};
use crate::geometry::{Pose, Rigid};
use crate::integrate::{Bridge, BridgeSettings, OccupancyIntegrator, OccupancySettings, Returns, TsdfIntegrator, TsdfSettings};
use crate::settings::{SettingError, Settings};
use std::collections::HashMap;
use std::time::Instant;

/// Turns a stream of events into an [`Atlas`].
#[derive(Debug)]
pub struct Mapper {
    settings: Settings,
    atlas: Atlas,
    front: Option<Front>,
    tsdf: TsdfIntegrator,
    occupancy: Option<OccupancyIntegrator>,
    bridge: Bridge,
    /// The submap that the odometry chain is in.
    current: Option<SubmapId>,
    submap_of_node: HashMap<NodeId, SubmapId>,
}

impl Mapper {
    /// A mapper with an empty atlas.
    ///
    /// # Errors
    /// Settings out of range, or that contradict each other.
    pub fn new(settings: Settings) -> Result<Self, SettingError> {
        settings.validate()?;
        let tsdf = TsdfIntegrator::new(TsdfSettings {
            voxel: settings.voxel,
            max_range: settings.max_range,
            truncation_voxels: settings.truncation,
            max_weight: settings.max_weight,
            max_scale: settings.max_scale,
            coarser_factor: settings.coarser_factor,
        });
        Ok(Self { settings, atlas: Atlas::default(), front: None, tsdf, occupancy: None, bridge: Bridge::default(), current: None, submap_of_node: HashMap::new() })
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The map so far.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// The map, without the mapper.
    pub fn into_atlas(self) -> Atlas {
        self.atlas
    }

    /// What was found out about the sensor; none before the first scan.
    pub fn sensor(&self) -> Option<&str> {
        self.front.as_ref().map(Front::description)
    }

    /// Takes the next event. A scan gives a report of what was done with it.
    ///
    /// # Errors
    /// An event that cannot be used is refused and named; the map is as it was before, and further events are welcome.
    pub fn handle(&mut self, event: Event) -> Result<Option<ScanReport>, MapError> {
        match event {
            Event::Scan(scan) => self.integrate(&scan).map(Some),
            // Edges and corrections take part from the pose graph on (Sec. IV-A); odometry alone cuts submaps by distance.
            Event::OdometryEdge(_) | Event::LoopEdge(_) | Event::PoseUpdate(_) => Ok(None),
        }
    }

    fn integrate(&mut self, scan: &Scan) -> Result<ScanReport, MapError> {
        if self.submap_of_node.contains_key(&scan.node) {
            return Err(MapError::DuplicateNode { node: scan.node });
        }
        check_pose(scan.node, &scan.t_map_lidar)?;
        let start = Instant::now();
        let front = match &mut self.front {
            Some(front) => front,
            None => self.front.insert(Front::open(&self.settings, &scan.cloud).map_err(|source| MapError::Sensor { node: scan.node, source })?),
        };
        front.prepare(&scan.cloud);
        let prepared = front.scan();
        if prepared.beams.is_empty() {
            return Err(MapError::NoReturns { node: scan.node, counts: prepared.counts });
        }
        let prepare = start.elapsed();

        let id = submap_for(&mut self.atlas, self.current, self.settings.lambda_odom, &scan.t_map_lidar);
        let is_new_submap = self.current != Some(id);
        self.current = Some(id);
        self.submap_of_node.insert(scan.node, id);
        let Some(submap) = self.atlas.submap_mut(id) else { return Err(MapError::LostSubmap { node: scan.node, submap: id }) };
        let t_submap_lidar = Rigid::from(&submap.add_scan(scan.node, &scan.t_map_lidar));
        let beams = &prepared.beams;
        let returns = Returns { points: &beams.points, normals: &beams.normals, shades: front.shades(), smallest_angle: beams.smallest_angle };
        let kind = self.settings.field;
        let tsdf = kind.has_tsdf().then(|| {
            let rule = self.tsdf.scale_rule(beams.smallest_angle);
            self.bridge.span(prepared, front.shades(), self.settings.voxel, &rule, &BridgeSettings { most: self.settings.bridge, ..BridgeSettings::default() });
            self.tsdf.integrate(&mut submap.tsdf, &t_submap_lidar, &self.bridge.returns())
        });
        let occupancy = kind.has_occupancy().then(|| {
            let integrator = self.occupancy.get_or_insert_with(|| OccupancyIntegrator::new(occupancy_settings(&self.settings), front.model()));
            integrator.integrate(&mut submap.occupancy, &t_submap_lidar, &prepared.image, &returns, front.fills_gaps())
        });
        Ok(ScanReport { node: scan.node, submap: id, is_new_submap, counts: prepared.counts, prepare, tsdf, occupancy })
    }
}

/// The submap that a scan at `t_map_lidar` goes into: the current one until `lambda_odom` metres were travelled from its
/// root pose, then a new one with this scan's pose as its root (paper Sec. IV-A, without loops).
fn submap_for(atlas: &mut Atlas, current: Option<SubmapId>, lambda_odom: f64, t_map_lidar: &Pose) -> SubmapId {
    match current.and_then(|id| atlas.submap(id)) {
        Some(submap) if submap.travelled_to(t_map_lidar) <= lambda_odom => submap.id,
        _ => atlas.spawn(*t_map_lidar),
    }
}

fn check_pose(node: NodeId, pose: &Pose) -> Result<(), MapError> {
    let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
    if numbers.clone().all(|c| c.is_finite()) && (pose.rotation.coords.norm() - 1.0).abs() < 1e-6 { Ok(()) } else { Err(MapError::BadPose { node }) }
}

fn occupancy_settings(settings: &Settings) -> OccupancySettings {
    OccupancySettings { voxel: settings.voxel, max_range: settings.max_range, ..OccupancySettings::default() }
}
