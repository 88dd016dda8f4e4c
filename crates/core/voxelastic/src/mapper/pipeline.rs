//! The mapper itself: what happens with each event, in order.

use super::assign::{assign, assign_within_lap};
use super::background_fusion::BackgroundFusion;
use super::clusters::Clusters;
use super::correct::{Deformation, correct_scans, deformations, move_submaps};
use super::error::MapError;
use super::frontend::FrontendScan;
use super::idle::{IdleTask, keep_threads_awake};
use super::integrators::Integrators;
use super::moving::MovingDetector;
use super::report::{Assignment, ElasticCounts, ScanReport};
use super::revisit::RevisitDetector;
use super::sensors::{Sensor, Sensors};
use crate::atlas::fusion::resolve_conflicts;
use crate::atlas::graph::{GraphCounts, LinkKind, is_rigid};
use crate::atlas::{Atlas, Submap, SubmapId, laps};
use crate::event::{Edge, Event, NodeId, Scan};
use crate::geometry::{Pose, Rigid};
use crate::integrate::{OccupancySettings, Redundancy};
use crate::sensor::BeamModel;
use crate::settings::{Dynamic, Laps, SettingError, Settings};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Turns a stream of events into an [`Atlas`].
#[derive(Debug)]
pub struct Mapper {
    pub(super) settings: Settings,
    pub(super) atlas: Atlas,
    pub(super) clusters: Clusters,
    pub(super) fusion: BackgroundFusion,
    pub(super) sensors: Sensors,
    /// The beam tables of the first sensor, if they are known from elsewhere.
    pub(super) sensor_model: Option<BeamModel>,
    pub(super) integrators: Integrators,
    pub(super) revisits: RevisitDetector,
    /// Where laps are kept apart, the first submap of this one, if it is known.
    pub(super) lap: Option<SubmapId>,
    /// Points of the last scan that were set aside, map frame, metres.
    moving_points: Vec<[f32; 3]>,
    idle_task: Option<IdleTask>,
    /// The node of the last scan, whether the scan was usable or not.
    pub(super) last_node: Option<NodeId>,
    pub(super) counts: ElasticCounts,
    /// Whether conflicts between submaps are resolved and no event came since.
    pub(super) conflicts_resolved: bool,
}

impl Mapper {
    /// A mapper with an empty atlas; [`builder`](Self::builder) has more options. A memory budget is the program's to set, for all mappers:
    /// [`Settings::limit_memory`].
    ///
    /// # Errors
    /// Settings out of range, or that contradict each other.
    pub fn new(settings: Settings) -> Result<Self, SettingError> {
        settings.validate()?;
        Ok(Self {
            atlas: Atlas::new(settings.voxel_size),
            clusters: Clusters::new(&settings),
            fusion: BackgroundFusion::new((&settings).into()),
            sensors: Sensors::default(),
            sensor_model: None,
            integrators: Integrators::new(&settings),
            revisits: RevisitDetector::new(&settings),
            lap: None,
            moving_points: Vec::new(),
            idle_task: None,
            last_node: None,
            counts: ElasticCounts::default(),
            conflicts_resolved: true,
            settings,
        })
    }

    /// Sets the sensor's beam tables before the first scan; see [`MapperBuilder::sensor_model`](super::MapperBuilder::sensor_model).
    pub fn set_sensor_model(&mut self, model: BeamModel) {
        self.sensor_model = Some(model);
    }

    /// Sets work for threads that are idle while a scan is integrated, such as decoding the next scan: threads of the pool in which
    /// [`handle`](Self::handle) is called, except the calling one. So this work does not compete with integration for processors.
    pub fn set_idle_task(&mut self, task: IdleTask) {
        self.idle_task = Some(task);
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The current map. A fusion may be in progress: see [`Atlas::merging`] and [`finish`](Self::finish).
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// The map, without the mapper; [finishes](Self::finish) it first.
    pub fn into_atlas(mut self) -> Atlas {
        self.finish();
        self.atlas
    }

    /// Completes all fusions, removes what moved, compacts the submaps, and [resolves conflicts](resolve_conflicts) between them. To be called before the map is stored; more events may follow.
    pub fn finish(&mut self) {
        self.finish_fusions();
        self.clean_submaps();
        self.atlas.compact();
        if !std::mem::replace(&mut self.conflicts_resolved, true) {
            self.resolve_conflicts();
        }
    }

    /// Resolves conflicts between submaps; between those of one lap only, where laps are kept apart: what one says of another time is no conflict.
    fn resolve_conflicts(&mut self) {
        let hit = OccupancySettings::from(&self.settings).hit;
        let settings = (&self.settings).into();
        if self.settings.laps == Laps::Fused {
            self.counts.voxels_freed += resolve_conflicts(&mut self.atlas, &settings, hit);
            return;
        }
        let (laps, voxel_size, next) = (laps(self.atlas.submaps()), self.atlas.voxel_size(), self.atlas.next_id());
        let mut by_lap: BTreeMap<Option<u32>, Vec<Submap>> = BTreeMap::new();
        for submap in std::mem::replace(&mut self.atlas, Atlas::new(voxel_size)).into_submaps() {
            by_lap.entry(laps.get(&submap.id()).copied()).or_default().push(submap);
        }
        let mut resolved = Vec::new();
        for submaps in by_lap.into_values() {
            let mut lap = Atlas::from_submaps(voxel_size, submaps);
            self.counts.voxels_freed += resolve_conflicts(&mut lap, &settings, hit);
            resolved.extend(lap.into_submaps());
        }
        self.atlas = Atlas::from_submaps(voxel_size, resolved);
        self.atlas.skip_ids(next);
    }

    /// Completes all fusions in progress or queued.
    pub fn finish_fusions(&mut self) {
        self.fusion.finish(&mut self.atlas, &self.clusters.graph);
    }

    /// Description of the sensor, or of all sensors whose clouds have come; none before the first scan.
    pub fn sensor(&self) -> Option<&str> {
        self.sensors.description()
    }

    /// Number of sensors whose clouds have come, see [`Cloud::sensor`](crate::Cloud::sensor).
    pub fn sensor_count(&self) -> usize {
        self.sensors.len()
    }

    /// How the clouds of the first sensor are laid out, see [`CloudLayout::name`](crate::sensor::CloudLayout::name); none before the first scan.
    pub fn sensor_layout(&self) -> Option<&'static str> {
        self.sensors.first().map(|sensor| sensor.frontend.layout().name())
    }

    /// Counts of submap assignments, fusions and corrections so far.
    pub fn elastic_counts(&self) -> ElasticCounts {
        ElasticCounts {
            fusions: self.fusion.done(),
            fusions_due: self.fusion.due(),
            size_limited_groups: self.clusters.size_limited_groups(),
            ..self.counts
        }
    }

    /// Points of the last scan that were set aside because they are on something that moves: map frame, at the scan's pose, metres.
    pub fn moving_points(&self) -> &[[f32; 3]] {
        &self.moving_points
    }

    /// Removes surfaces from places where nothing is before or after.
    fn clean_submaps(&mut self) {
        if self.settings.dynamic != Dynamic::Remove {
            return;
        }
        let laps = if self.settings.laps == Laps::Apart { laps(self.atlas.submaps()) } else { BTreeMap::new() };
        let Clusters { graph, assignments, .. } = &self.clusters;
        let lap_of = |node| assignments.submap_of(node).and_then(|id| laps.get(&id));
        for Sensor { frontend, moving, .. } in self.sensors.iter_mut() {
            for submap in self.atlas.submaps_mut() {
                let lap = laps.get(&submap.id());
                self.counts.voxels_removed += moving.clean(submap, graph, frontend.model(), &|node| lap_of(node) == lap);
            }
        }
    }

    /// Finds the returns of a scan into submap `id` that are on something that moves, a flag each; empty if none is.
    fn find_moving(
        &mut self,
        id: SubmapId,
        scan: &Scan,
        t_submap_lidar: &Pose,
        prepared: &FrontendScan<'_>,
        moving: &mut MovingDetector,
    ) -> Vec<bool> {
        self.moving_points.clear();
        if self.settings.dynamic == Dynamic::Keep {
            return Vec::new();
        }
        if moving.submap() != Some(id) {
            let root = |id| self.clusters.graph.pose(self.clusters.assignments.root(id)?);
            let t_new_old = moving.submap().and_then(|old| Some((t_submap_lidar * scan.t_map_lidar.inverse()) * root(old)?));
            moving.enter(id, t_new_old.as_ref());
        }
        let returns = &prepared.scan().returns;
        let moves = moving.judge(t_submap_lidar, prepared.scan(), prepared.model());
        let t_map_lidar = Rigid::from(&scan.t_map_lidar);
        let points = returns.points.iter().zip(&moves).take(returns.measured).filter(|(_, moves)| **moves);
        self.moving_points.extend(points.map(|(p, _)| t_map_lidar.apply(*p)));
        self.counts.moving_points += self.moving_points.len();
        moving.remember(scan.node, t_submap_lidar, Some(&scan.t_map_lidar), prepared.scan(), prepared.model());
        moves
    }

    /// Current pose of the lidar at a node, map frame; none if the node is not known.
    pub fn pose(&self, node: NodeId) -> Option<Pose> {
        self.clusters.graph.pose(node).copied()
    }

    /// Number of nodes and links of the pose graph.
    pub fn graph_counts(&self) -> GraphCounts {
        self.clusters.graph.counts()
    }

    /// Every submap's deformation under the current poses, by submap.
    pub fn deformations(&self) -> Vec<Deformation> {
        deformations(&self.atlas, &self.clusters.graph)
    }

    /// Submaps deformed by more than `deform_tolerance` or `deform_angle_tolerance`: they are rigid and cannot follow such corrections, but
    /// can be [rebuilt](Self::rebuild).
    pub fn deformed(&self) -> Vec<Deformation> {
        let distance = self.settings.deform_tolerance * f64::from(self.settings.voxel_size);
        let angle = self.settings.deform_angle_tolerance.to_radians();
        self.deformations().into_iter().filter(|d| d.distance > distance || d.angle > angle).collect()
    }

    /// Handles the next event; a scan returns a report.
    ///
    /// # Errors
    /// An event that cannot be used is refused and named; the map is unchanged, and further events can follow.
    pub fn handle(&mut self, event: Event) -> Result<Option<ScanReport>, MapError> {
        self.conflicts_resolved = false;
        match event {
            Event::Scan(scan) => self.integrate(&scan).map(Some),
            Event::OdometryEdge(edge) => self.add_edge(LinkKind::Odometry, &edge).map(|()| None),
            Event::LoopEdge(edge) => self.add_edge(LinkKind::Loop, &edge).map(|()| None),
            Event::PoseUpdate(poses) => self.update_poses(&poses).map(|()| None),
            Event::Vertical(_) => Ok(None),
        }
    }

    /// Integrates a scan, which stays the caller's: what [`handle`](Self::handle) does with one.
    ///
    /// # Errors
    /// A scan that cannot be used is refused and named; the map is unchanged, and others can follow.
    pub fn integrate(&mut self, scan: &Scan) -> Result<ScanReport, MapError> {
        self.conflicts_resolved = false;
        keep_threads_awake(self.idle_task.clone(), || self.add_scan(scan))
    }

    fn add_edge(&mut self, kind: LinkKind, edge: &Edge) -> Result<(), MapError> {
        self.counts.edges_replaced += usize::from(self.clusters.add_edge(kind, edge)?);
        self.queue_fusions();
        Ok(())
    }

    fn queue_fusions(&mut self) {
        self.fusion.enqueue(self.clusters.fusions());
    }

    /// Applies corrected poses (Sec. IV-D). Poses of unknown nodes are counted and ignored.
    fn update_poses(&mut self, poses: &[(NodeId, Pose)]) -> Result<(), MapError> {
        if let Some((node, _)) = poses.iter().find(|(_, pose)| !is_rigid(pose)) {
            return Err(MapError::BadPose { node: *node });
        }
        self.counts.pose_updates += 1;
        self.counts.unknown_poses += self.clusters.graph.update_poses(poses);
        self.clusters.graph.refresh_loops();
        let (distance, angle) = (self.settings.update_distance, self.settings.update_angle.to_radians());
        self.counts.submap_moves += move_submaps(&mut self.atlas, &self.clusters.graph, distance, angle);
        correct_scans(&mut self.atlas, &self.clusters.graph);
        self.queue_fusions();
        Ok(())
    }

    fn add_scan(&mut self, scan: &Scan) -> Result<ScanReport, MapError> {
        if self.clusters.assignments.submap_of(scan.node).is_some() {
            return Err(MapError::DuplicateNode { node: scan.node });
        }
        if !is_rigid(&scan.t_map_lidar) {
            return Err(MapError::BadPose { node: scan.node });
        }
        let mut sensors = std::mem::take(&mut self.sensors);
        let result = self.add_scan_from(&mut sensors, scan);
        self.sensors = sensors;
        result
    }

    /// As [`add_scan`](Self::add_scan), with the sensors apart: a prepared scan borrows from one of them.
    fn add_scan_from(&mut self, sensors: &mut Sensors, scan: &Scan) -> Result<ScanReport, MapError> {
        let sensor = sensors.of(&self.settings, self.sensor_model.as_ref(), &scan.cloud, scan.node);
        let Sensor { frontend, moving, .. } = sensor.map_err(|reason| MapError::Sensor { node: scan.node, reason })?;
        let start = Instant::now();
        let mut prepared = frontend.prepare(&scan.cloud);
        let prepare = start.elapsed();
        // The node is added to the graph even if its scan is not usable: edges may lead over it.
        self.clusters.graph.add_node(scan.node, &scan.t_map_lidar);
        if let Some(last) = self.last_node.replace(scan.node) {
            self.clusters.graph.assume_odometry(last, scan.node);
        }
        let result = self.map_prepared(scan, &mut prepared, moving, prepare);
        let clock = Instant::now();
        self.queue_fusions();
        let entered = result.as_ref().ok().map(|report| report.submap);
        self.fusion.step(&mut self.atlas, &self.clusters.graph, entered);
        result.map(|report| ScanReport { elastic: report.elastic + clock.elapsed(), ..report })
    }

    fn map_prepared(
        &mut self,
        scan: &Scan,
        prepared: &mut FrontendScan<'_>,
        moving: &mut MovingDetector,
        prepare: Duration,
    ) -> Result<ScanReport, MapError> {
        let (node, counts) = (scan.node, prepared.scan().counts);
        if prepared.scan().returns.is_empty() {
            return Err(MapError::NoReturns { node, counts });
        }
        let clock = Instant::now();
        let (id, assignment) = match self.settings.laps {
            Laps::Fused => assign(&mut self.clusters, &mut self.atlas, scan, prepared, self.settings.min_overlap),
            Laps::Apart => assign_within_lap(&self.clusters, &mut self.atlas, scan, &mut self.lap),
        };
        let revisited = self.revisits.revisited_submaps(&self.clusters, node, &scan.t_map_lidar);
        let elastic = clock.elapsed();
        // The root's pose in the graph, not the submap's: that one may differ from it by up to `update_distance`.
        let root = self.clusters.assignments.root(id).and_then(|root| self.clusters.graph.pose(root)).copied().unwrap_or(scan.t_map_lidar);
        let t_submap_lidar = root.inv_mul(&scan.t_map_lidar);
        // Other submaps are compacted while the planes are fitted: the two are independent.
        let (planes, ()) = rayon::join(
            || {
                let clock = Instant::now();
                prepared.fit_planes_for_map(&self.settings);
                clock.elapsed()
            },
            || self.atlas.compact_others(id),
        );
        let prepare = prepare + planes;
        let clock = Instant::now();
        let moves = self.find_moving(id, scan, &t_submap_lidar, prepared, moving);
        let prepare = prepare + clock.elapsed();
        let before = self.revisits.blocks_before(&self.atlas, id, &revisited);
        let Some((submap, others)) = self.atlas.with_neighbours(id, &revisited) else { return Err(MapError::LostSubmap { node, submap: id }) };
        self.clusters.assignments.add(node, id);
        let elsewhere = others.into_iter().map(|(other, t_map_other)| (&other.tsdf, Rigid::from(&t_map_other.inv_mul(&root)))).collect();
        let redundancy = Redundancy { before, elsewhere };
        submap.add_scan_at(node, t_submap_lidar);
        let (tsdf, occupancy) =
            self.integrators.integrate(scan.cloud.sensor, submap, &t_submap_lidar, &prepared.without(&moves), &self.settings, &redundancy);
        let is_new_submap = assignment == Assignment::NewSubmap;
        self.counts.count(assignment);
        let moving = self.moving_points.len();
        Ok(ScanReport { node, submap: id, is_new_submap, assignment, moving, counts, prepare, elastic, tsdf, occupancy })
    }
}
