//! The mapper: events in, an elastic atlas out. One path for live and replayed input (paper Fig. 4).
//!
//! [`Mapper::handle`] takes each [`Event`] as it happens. A scan is prepared (range image, local planes), assigned to a submap (`assign`,
//! Sec. IV-A), and integrated into the submap's fields in the submap's frame (Sec. IV-B). Loops that close start fusions, which run
//! beside integration (`fusing`, Sec. IV-C). Corrected poses move root poses and nothing else (`correct`, Sec. IV-D); a submap that a
//! correction bent inside is reported and can be made anew from its scans (`rebuild`). Where the sensor has been before, scans add to surfaces
//! what was not known (`returning`).

mod assign;
mod awake;
mod correct;
mod front;
mod fusing;
mod rebuild;
mod report;
mod returning;

pub use awake::Chore;
pub use correct::Deformation;
pub use front::Front;
pub use rebuild::{RebuildError, RebuildReport, ScanSource};
pub use report::{ElasticCounts, MapError, Placed, ScanReport};

use crate::atlas::cluster::{ClusterRule, Clustered};
use crate::atlas::fusion::settle_doubts;
use crate::atlas::graph::{Agreement, EdgeOutcome, GraphCounts, LinkKind, PoseGraph, is_rigid};
use crate::atlas::{Atlas, Members, Submap, SubmapId};
use crate::event::{Edge, Event, NodeId, Scan};
use crate::geometry::{Pose, Rigid};
use crate::integrate::{Known, OccupancyIntegrator, OccupancySettings, OccupancyStats, Returns, TsdfIntegrator, TsdfSettings, TsdfStats, paint};
use crate::sensor::BeamModel;
use crate::settings::{NoReturn, SettingError, Settings};
use fusing::Fusing;
use std::collections::{BTreeMap, HashSet};
use std::time::{Duration, Instant};

/// Turns a stream of events into an [`Atlas`].
#[derive(Debug)]
pub struct Mapper {
    settings: Settings,
    rule: ClusterRule,
    atlas: Atlas,
    graph: PoseGraph,
    members: Members,
    fusing: Fusing,
    front: Option<Front>,
    /// The sensor, where its beams are known from elsewhere.
    known: Option<BeamModel>,
    integrators: Integrators,
    /// For threads with time to spare.
    chore: Option<Chore>,
    /// The node that came last, whether its scan could be used or not.
    last_node: Option<NodeId>,
    /// The submap that the sensor has returned to, if it has.
    visit: Option<Visit>,
    /// Groups of submaps that a closed loop joins and the bound keeps apart, each with the ends of such a loop.
    apart: BTreeMap<Vec<SubmapId>, [NodeId; 2]>,
    counts: ElasticCounts,
    /// Whether nothing has come since submaps settled their doubts.
    is_settled: bool,
}

/// A return to a submap.
#[derive(Clone, Copy, Debug)]
struct Visit {
    submap: SubmapId,
    /// How many blocks its TSDF had before.
    blocks: u32,
}

impl Mapper {
    /// A mapper with an empty atlas.
    ///
    /// # Errors
    /// Settings out of range, or that contradict each other.
    pub fn new(settings: Settings) -> Result<Self, SettingError> {
        settings.validate()?;
        let distance = settings.loop_tolerance * f64::from(settings.voxel);
        let agreement = Agreement { distance, angle: settings.update_angle.to_radians() };
        Ok(Self {
            rule: ClusterRule { lambda_odom: settings.lambda_odom, lambda_cluster: settings.lambda_cluster },
            atlas: Atlas::default(),
            graph: PoseGraph::new(agreement),
            members: Members::default(),
            fusing: Fusing::new((&settings).into()),
            front: None,
            known: None,
            integrators: Integrators::new(&settings),
            chore: None,
            last_node: None,
            visit: None,
            apart: BTreeMap::new(),
            counts: ElasticCounts::default(),
            is_settled: true,
            settings,
        })
    }

    /// Tells the sensor's own tables of beams. They are used for organised clouds that have the model's pixels in their places, unless the
    /// settings name a sensor; to be called before the first scan.
    pub fn know_sensor(&mut self, model: BeamModel) {
        self.known = Some(model);
    }

    /// Gives threads something to do that would have nothing to do while a scan is integrated, such as decoding the next one: threads of the pool that
    /// [`handle`](Self::handle) is called in, except the one that calls it. Thus nothing has to compete with them for processors.
    pub fn set_chore(&mut self, chore: Chore) {
        self.chore = Some(chore);
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The map so far. A fusion may be under way: see [`Atlas::retiring`] and [`finish`](Self::finish).
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// The map, without the mapper; fusions under way are finished first.
    pub fn into_atlas(mut self) -> Atlas {
        self.finish();
        self.atlas
    }

    /// Does all fusions that are under way or due, and lets submaps settle their [doubts](settle_doubts). To be called before the map is
    /// stored; more events may follow.
    pub fn finish(&mut self) {
        self.finish_fusions();
        self.atlas.rest();
        if !std::mem::replace(&mut self.is_settled, true) {
            let hit = occupancy_settings(&self.settings).hit;
            self.counts.voxels_freed += settle_doubts(&mut self.atlas, &(&self.settings).into(), hit);
        }
    }

    /// Does all fusions that are under way or due.
    pub fn finish_fusions(&mut self) {
        self.fusing.finish(&mut self.atlas, &self.graph);
    }

    /// What was found out about the sensor; none before the first scan.
    pub fn sensor(&self) -> Option<&str> {
        self.front.as_ref().map(Front::description)
    }

    /// What the elastic part did so far.
    pub fn elastic_counts(&self) -> ElasticCounts {
        ElasticCounts { fusions: self.fusing.done(), fusions_due: self.fusing.due(), groups_apart: self.apart.len(), ..self.counts }
    }

    /// What is in the pose graph.
    pub fn graph_counts(&self) -> GraphCounts {
        self.graph.counts()
    }

    /// Takes the next event. A scan gives a report of what was done with it.
    ///
    /// # Errors
    /// An event that cannot be used is refused and named; the map is as it was before, and further events are welcome.
    pub fn handle(&mut self, event: Event) -> Result<Option<ScanReport>, MapError> {
        self.is_settled = false;
        match event {
            Event::Scan(scan) => awake::keeping_awake(self.chore.clone(), || self.integrate(&scan)).map(Some),
            Event::OdometryEdge(edge) => self.add_edge(LinkKind::Odometry, &edge).map(|()| None),
            Event::LoopEdge(edge) => self.add_edge(LinkKind::Loop, &edge).map(|()| None),
            Event::PoseUpdate(poses) => self.update_poses(&poses).map(|()| None),
        }
    }

    fn add_edge(&mut self, kind: LinkKind, edge: &Edge) -> Result<(), MapError> {
        let outcome = self.graph.add_edge(kind, edge)?;
        self.counts.edges_replaced += usize::from(outcome == EdgeOutcome::Replaced);
        self.cluster();
        Ok(())
    }

    /// Lets the loops that closed ask for fusions (Sec. IV-A, IV-C), and those near them again that the bound has kept apart so far.
    fn cluster(&mut self) {
        let closed = self.graph.take_closed();
        if closed.is_empty() {
            return;
        }
        let near: HashSet<NodeId> = self.graph.within(closed.as_flattened(), self.rule.influence()).into_iter().map(|(node, _)| node).collect();
        let mut asking: Vec<[NodeId; 2]> = self.apart.extract_if(.., |_, ends| near.contains(&ends[0])).map(|(_, ends)| ends).collect();
        asking.extend(closed);
        for ends in asking {
            let Clustered { fusions, left } = self.rule.cluster(&self.graph, &mut self.members, ends);
            self.fusing.ask(fusions);
            if left.len() > 1 {
                self.apart.insert(left, ends);
            }
        }
    }

    fn integrate(&mut self, scan: &Scan) -> Result<ScanReport, MapError> {
        if self.members.submap_of(scan.node).is_some() {
            return Err(MapError::DuplicateNode { node: scan.node });
        }
        if !is_rigid(&scan.t_map_lidar) {
            return Err(MapError::BadPose { node: scan.node });
        }
        let mut front = match self.front.take() {
            Some(front) => front,
            None => Front::open(&self.settings, self.known.as_ref(), &scan.cloud).map_err(|source| MapError::Sensor { node: scan.node, source })?,
        };
        let start = Instant::now();
        front.prepare(&scan.cloud);
        let prepare = start.elapsed();
        // The node is part of the graph even if its scan cannot be used: edges lead through it.
        self.graph.add_node(scan.node, &scan.t_map_lidar);
        if let Some(last) = self.last_node.replace(scan.node) {
            self.graph.assume_odometry(last, scan.node);
        }
        let result = self.integrate_prepared(scan, &mut front, prepare);
        self.front = Some(front);
        let clock = Instant::now();
        self.cluster();
        self.fusing.advance(&mut self.atlas, &self.graph);
        result.map(|report| ScanReport { elastic: report.elastic + clock.elapsed(), ..report })
    }

    fn integrate_prepared(&mut self, scan: &Scan, front: &mut Front, prepare: Duration) -> Result<ScanReport, MapError> {
        let (node, counts) = (scan.node, front.scan().counts);
        if front.scan().beams.is_empty() {
            return Err(MapError::NoReturns { node, counts });
        }
        let clock = Instant::now();
        let (id, placed) = self.assign(scan, front);
        let returned_to = self.returned_to(node, &scan.t_map_lidar);
        let before = self.visit(id, &returned_to);
        let elastic = clock.elapsed();
        // The root's pose in the graph, not the submap's: that one may lag behind by `update_distance`.
        let root = self.members.root(id).and_then(|root| self.graph.pose(root)).copied().unwrap_or(scan.t_map_lidar);
        // Submaps that are left come to rest while the planes are fitted: neither needs the other.
        let (planes, ()) = rayon::join(
            || {
                let clock = Instant::now();
                front.finish(&scan.cloud);
                clock.elapsed()
            },
            || self.atlas.rest_beside(id),
        );
        let prepare = prepare + planes;
        let Some((submap, others)) = self.atlas.beside(id, &returned_to) else { return Err(MapError::LostSubmap { node, submap: id }) };
        self.members.add(node, id);
        let t_submap_lidar = root.inv_mul(&scan.t_map_lidar);
        let elsewhere = others.into_iter().map(|(other, t_map_other)| (&other.tsdf, Rigid::from(&t_map_other.inv_mul(&root)))).collect();
        let known = Known { before, elsewhere };
        submap.place_scan(node, t_submap_lidar);
        let (tsdf, occupancy) = self.integrators.integrate(submap, &t_submap_lidar, front, &self.settings, &known);
        let is_new_submap = placed == Placed::NewSubmap;
        self.counts.note(placed);
        Ok(ScanReport { node, submap: id, is_new_submap, placed, counts, prepare, elastic, tsdf, occupancy })
    }
}

/// The integrators of both fields: they hold scratch memory, so there is one of each for all submaps.
#[derive(Debug)]
struct Integrators {
    tsdf: TsdfIntegrator,
    occupancy: Option<OccupancyIntegrator>,
}

impl Integrators {
    fn new(settings: &Settings) -> Self {
        let tsdf = TsdfIntegrator::new(TsdfSettings {
            voxel: settings.voxel,
            max_range: settings.max_range,
            truncation_voxels: settings.truncation,
            truncation_new: settings.truncation_new,
            truncation_behind: settings.truncation_behind,
            max_weight: settings.max_weight,
            max_scale: settings.max_scale,
            coarser_factor: settings.coarser_factor,
            ..TsdfSettings::default()
        });
        Self { tsdf, occupancy: None }
    }

    /// Integrates the scan that `front` prepared last; of surfaces what is not `known`.
    fn integrate(
        &mut self,
        submap: &mut Submap,
        t_submap_lidar: &Pose,
        front: &Front,
        settings: &Settings,
        known: &Known<'_>,
    ) -> (Option<TsdfStats>, Option<OccupancyStats>) {
        let (t_submap_lidar, prepared) = (Rigid::from(t_submap_lidar), front.scan());
        let beams = &prepared.beams;
        let returns = Returns {
            points: &beams.points,
            normals: &beams.normals,
            shades: front.shades(),
            origins: &beams.origins,
            smallest_angle: beams.smallest_angle,
        };
        let kind = settings.field;
        let tsdf = kind.has_tsdf().then(|| self.tsdf.integrate_unknown(&mut submap.tsdf, &t_submap_lidar, &returns, known));
        if tsdf.is_some() && !front.colours().is_empty() {
            paint(&mut submap.tsdf, &t_submap_lidar, &returns, front.colours(), settings.voxel, settings.max_range);
        }
        let occupancy = kind.has_occupancy().then(|| {
            let integrator = self.occupancy.get_or_insert_with(|| OccupancyIntegrator::new(occupancy_settings(settings), front.model()));
            let (image, fills_gaps) = prepared.from_one_place(front.fills_gaps());
            integrator.integrate(&mut submap.occupancy, &t_submap_lidar, image, &returns, fills_gaps)
        });
        (tsdf, occupancy)
    }
}

fn occupancy_settings(settings: &Settings) -> OccupancySettings {
    let clear_no_return = settings.no_return == NoReturn::Free;
    OccupancySettings { voxel: settings.voxel, max_range: settings.max_range, clear_no_return, ..OccupancySettings::default() }
}
