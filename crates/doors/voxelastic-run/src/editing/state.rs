//! A map with edits: what each does to the map that those before it have made.

use super::graph::{Graph, now, poses};
use super::list::{Between, Edit, Pin, Target, Up};
use super::region::Region;
use super::register::{Fit, register};
use crate::error::{Error, Result};
use crate::georeference::move_submap;
use crate::map_files;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::atlas::fusion::{FusionSettings, fuse};
use voxelastic::atlas::{Submap, SubmapId};
use voxelastic::changes::{Erase, ErasedVoxels, OccupancyThen, erase};
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseExt;
use voxelastic::settings::Settings;
use voxelastic_io::Origin;
use voxelastic_io::store::{MapDetails, MapStore, ScanEntry, SessionEntry, SubmapEntry};
use voxelastic_slam::graph::{HeldRotation, Hold};

/// A point that is held is where it should be after so many rounds, as far as anybody measures.
const POINT_ROUNDS: usize = 4;

/// What an edit did.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Done {
    /// What it is called.
    pub kind: &'static str,
    /// Voxels of surfaces that were erased, at all scales.
    pub surface_voxels: u64,
    /// Finest voxels whose occupancy is another one.
    pub occupancy_voxels: u64,
    /// By how much a scan moved at most, metres.
    pub moved_most_m: f64,
    /// How well two submaps fit that were registered.
    pub fit: Option<Fit>,
}

impl Done {
    /// What an edit did, in words.
    pub fn words(&self) -> String {
        let mut words = self.kind.to_owned();
        if self.surface_voxels + self.occupancy_voxels > 0 {
            words += &format!(": {} voxels of surfaces and {} of occupancy", self.surface_voxels, self.occupancy_voxels);
        }
        if let Some(fit) = &self.fit {
            let (overlap, spread) = (100.0 * fit.overlap, 100.0 * fit.spread_m);
            words += &format!(": {} places fit, {overlap:.0} % of their surfaces, {spread:.1} cm apart", fit.edges);
        }
        if self.moved_most_m > 0.0 {
            words += &format!(": scans moved by up to {:.3} m", self.moved_most_m);
        }
        words
    }
}

/// A map with edits.
#[derive(Clone)]
pub(super) struct State {
    pub(super) base: MapStore,
    settings: Settings,
    pub(super) origin: Origin,
    pub(super) entries: Vec<SubmapEntry>,
    /// Those whose fields are others than before the edits.
    pub(super) changed: BTreeMap<SubmapId, Arc<Submap>>,
    pub(super) sessions: Vec<SessionEntry>,
    /// Pairs that are never closed or merged, the smaller number first.
    pub(super) apart: BTreeSet<[SubmapId; 2]>,
    /// Once somebody asks for it.
    graph: Option<Graph>,
}

impl State {
    /// The map before all edits.
    pub fn of(base: &MapStore) -> Result<Self> {
        let manifest = base.manifest();
        Ok(Self {
            settings: map_files::settings_of(base)?,
            origin: map_files::origin_of(base)?,
            entries: manifest.submaps.clone(),
            changed: BTreeMap::new(),
            sessions: manifest.sessions.clone(),
            apart: BTreeSet::new(),
            graph: None,
            base: base.clone(),
        })
    }

    /// Makes the edit. One that names places that must be registered first has what was found in it afterwards.
    pub fn apply(&mut self, edit: &mut Edit) -> Result<Done> {
        let kind = edit.kind();
        let done = match edit {
            Edit::Erase { region, surfaces, occupancy, submaps } => {
                let what = Erase { surfaces: *surfaces, occupancy: *occupancy };
                submaps.iter().try_for_each(|id| self.entry(*id).map(drop))?;
                let erased = self.erase(&|p| region.distance(p), what, &|id| submaps.is_empty() || submaps.contains(&id))?;
                self.must_change(erased, region)?
            }
            Edit::Crop { region } => {
                let what = Erase { surfaces: true, occupancy: Some(OccupancyThen::Unknown) };
                let erased = self.erase(&|p| -region.distance(p), what, &|_| true)?;
                self.must_change(erased, region)?
            }
            Edit::Pin { target, pin } => self.pin(*target, pin)?,
            Edit::Closure { between, start, edges } => {
                let submaps = self.submaps_of(*between)?;
                self.check_not_apart(submaps)?;
                let fit = if edges.is_empty() { Some(self.register(*between, *start, edges)?) } else { None };
                for node in edges.iter().flat_map(|edge| [edge.from, edge.to]) {
                    self.submap_of(node)?;
                }
                self.graph()?.add(edges);
                Done { fit, ..self.solve()? }
            }
            Edit::RemoveClosure { scans } => {
                let closures = self.graph()?.closures();
                if self.graph()?.remove(*scans)? == 0 {
                    let known: Vec<String> = closures.iter().take(20).map(|[a, b]| format!("{a} and {b}")).collect();
                    let known =
                        if known.is_empty() { "the map has none".to_owned() } else { format!("there are those between {}", known.join("; ")) };
                    return Err(Error::new(format!("no closure is between scans {} and {}: {known}", scans[0], scans[1]), ""));
                }
                self.solve()?
            }
            Edit::Merge { into, from } => self.merge(*into, *from)?,
            Edit::KeepApart { submaps } => self.keep_apart(*submaps)?,
            Edit::AlignSession { session, t_map_session } => self.align(session, t_map_session)?,
            Edit::Origin { at, yaw } => self.set_origin(*at, *yaw)?,
            Edit::Note { .. } => Done::default(),
        };
        Ok(Done { kind, ..done })
    }

    /// How the map was made: no edit changes that.
    pub fn details(&self) -> MapDetails {
        self.base.manifest().details.clone()
    }

    /// The pose graph, which is made once.
    pub(super) fn graph(&mut self) -> Result<&mut Graph> {
        let graph = match self.graph.take() {
            Some(graph) => graph,
            None => Graph::of(&self.base)?,
        };
        Ok(self.graph.insert(graph))
    }

    pub(super) fn entry(&self, id: SubmapId) -> Result<&SubmapEntry> {
        let found = self.entries.binary_search_by_key(&id, |entry| entry.id).ok().map(|i| &self.entries[i]);
        found.ok_or_else(|| {
            Error::new(format!("there is no submap {id}"), "`voxelastic info MAP` lists the submaps, `voxelastic edit MAP --list` the edits")
        })
    }

    pub(super) fn submap_of(&self, node: NodeId) -> Result<SubmapId> {
        let entry = self.entries.iter().find(|entry| entry.scans.iter().any(|scan| scan.node == node));
        entry.map(|entry| entry.id).ok_or_else(|| Error::new(format!("there is no scan {node}"), "scans have the numbers of their nodes"))
    }

    fn submaps_of(&self, between: Between) -> Result<[SubmapId; 2]> {
        match between {
            Between::Submaps(ids) => Ok(ids),
            Between::Scans([a, b]) => Ok([self.submap_of(a)?, self.submap_of(b)?]),
        }
    }

    /// A submap as it is now.
    pub(super) fn submap(&self, id: SubmapId) -> Result<Submap> {
        let entry = self.entry(id)?;
        let mut submap = match self.changed.get(&id) {
            Some(changed) => Submap::clone(changed),
            None => self.base.load_submap(id).map_err(|error| map_files::damaged_part(self.base.dir(), error))?,
        };
        submap.set_pose(entry.t_map_submap);
        Ok(submap.with_corrected(entry.corrected.iter().map(|scan| scan.t_submap_lidar).collect()))
    }

    /// Erases in the submaps that `is_meant`. The distance to the region is that of points as users have them.
    fn erase(
        &mut self,
        distance: &(impl Fn([f64; 3]) -> f64 + Sync),
        what: Erase,
        is_meant: &(impl Fn(SubmapId) -> bool + Sync),
    ) -> Result<ErasedVoxels> {
        let settings = FusionSettings::from(&self.settings);
        let (this, origin) = (&*self, self.origin);
        let of_user = |p: [f64; 3]| distance(origin.point_to_map(p));
        let meant: Vec<SubmapId> = this.entries.iter().map(|entry| entry.id).filter(|id| is_meant(*id)).collect();
        let erase = |id: &SubmapId| {
            let mut submap = this.submap(*id)?;
            let erased = erase(&mut submap, &of_user, what, &settings);
            Ok((!erased.is_none()).then_some((submap, erased)))
        };
        let outcomes: Vec<Result<Option<(Submap, ErasedVoxels)>>> = meant.par_iter().map(erase).collect();
        let mut all = ErasedVoxels::default();
        for (submap, erased) in outcomes.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten() {
            all += erased;
            self.changed.insert(submap.id(), Arc::new(submap));
        }
        Ok(all)
    }

    fn must_change(&self, erased: ErasedVoxels, region: &Region) -> Result<Done> {
        if erased.is_none() {
            let name = match region {
                Region::Box { .. } => "box",
                Region::Sphere { .. } => "sphere",
                Region::Prism { .. } => "prism",
            };
            return Err(Error::new(format!("nothing of the map would be erased by this {name}"), "coordinates are those of the map, metres"));
        }
        Ok(Done { surface_voxels: erased.surface, occupancy_voxels: erased.occupancy, ..Done::default() })
    }

    fn pin(&mut self, target: Target, pin: &Pin) -> Result<Done> {
        let (id, node) = match target {
            Target::Scan(node) => (self.submap_of(node)?, Some(node)),
            Target::Submap(id) => (id, None),
        };
        let entry = self.entry(id)?;
        let scan = now(entry).find(|(other, _)| node.is_none_or(|node| node == *other));
        let (node, t_submap_node) = scan.ok_or_else(|| Error::new(format!("submap {id} has no scan by which it could be held"), ""))?;
        let t_map_node = entry.t_map_submap * t_submap_node;
        // What is held, in the frame of the scan by which it is.
        let t_node_held = if matches!(target, Target::Submap(_)) { t_submap_node.inverse() } else { Pose::identity() };
        let t_map_held = t_map_node * t_node_held;
        let point = pin.at.map_or(t_map_held.translation.vector, |at| Vector3::from(self.origin.point_to_local(at)));
        let offset = t_map_node.translation.vector - point;
        let mut hold = Hold { node, position: [None; 3], rotation: HeldRotation::Free };
        if let Some(pose) = &pin.pose {
            hold = Hold::at(node, &(self.origin.to_local(*pose) * t_node_held.inverse()));
        }
        if let Some(position) = pin.position {
            let local = self.origin.point_to_local(position);
            hold.position = std::array::from_fn(|k| Some(local[k] + offset[k]));
        }
        if let Some(height) = pin.height {
            hold.position[2] = Some(self.origin.point_to_local([0.0, 0.0, height])[2] + offset.z);
        }
        if let Some(up) = pin.up {
            let up = match up {
                Up::Own => t_node_held.rotation * Vector3::z(),
                Up::Direction(up) => t_map_node.rotation.inverse() * Vector3::from(up).normalize(),
            };
            hold.rotation = HeldRotation::Up(up);
        }
        self.graph()?.hold(hold);
        let mut done = self.solve()?;
        // A point away from the scan goes elsewhere when the scan turns, which is known only then.
        for _ in 0..if pin.at.is_some() { POINT_ROUNDS } else { 0 } {
            let pose = poses(&self.entries)[&node];
            let now = pose * nalgebra::Point3::from(t_map_node.inverse() * nalgebra::Point3::from(point));
            let offset = pose.translation.vector - now.coords;
            let wanted = pin.position.or(pin.height.map(|height| [0.0, 0.0, height])).map(|p| self.origin.point_to_local(p));
            hold.position = std::array::from_fn(|k| hold.position[k].and(wanted).map(|wanted| wanted[k] + offset[k]));
            self.graph()?.hold(hold);
            done.moved_most_m = done.moved_most_m.max(self.solve()?.moved_most_m);
        }
        Ok(done)
    }

    fn register(&self, between: Between, start: Option<Pose>, edges: &mut Vec<voxelastic::event::Edge>) -> Result<Fit> {
        let ids = self.submaps_of(between)?;
        if ids[0] == ids[1] {
            let message = format!("both are of submap {}, which is rigid", ids[0]);
            return Err(Error::new(message, "name scans of two submaps; or give what is `measured`"));
        }
        let [a, b] = [self.submap(ids[0])?, self.submap(ids[1])?];
        let poses = poses(&self.entries);
        let pose = |which: usize| match between {
            Between::Submaps(_) => Some([&a, &b][which].t_map_submap()),
            Between::Scans(scans) => poses.get(&scans[which]).copied(),
        };
        let start = start.and_then(|start| Some(pose(0)? * start * pose(1)?.inverse()));
        let (found, fit) = register(&a, &b, start)?;
        *edges = found;
        Ok(fit)
    }

    /// Lets the map follow what is known.
    fn solve(&mut self) -> Result<Done> {
        let before = poses(&self.entries);
        let submap_of = self.entries.iter().flat_map(|entry| entry.scans.iter().map(|scan| (scan.node, entry.id))).collect();
        let solved: HashMap<NodeId, Pose> = self.graph()?.solve(&before, &submap_of)?.into_iter().collect();
        let voxel = f64::from(self.settings.voxel_size);
        self.entries.iter_mut().for_each(|entry| move_submap(entry, &solved, Origin::default(), voxel));
        Ok(Done { moved_most_m: self.moved_since(&before), ..Done::default() })
    }

    pub(super) fn moved_since(&self, before: &BTreeMap<NodeId, Pose>) -> f64 {
        let after = poses(&self.entries);
        before.iter().filter_map(|(node, pose)| Some(after.get(node)?.translation_distance(pose))).fold(0.0, f64::max)
    }

    fn merge(&mut self, into: SubmapId, from: SubmapId) -> Result<Done> {
        let session = |id: SubmapId| self.sessions.iter().find(|session| session.has(id)).map(|session| session.number);
        let (mut target, source) = (self.submap(into)?, self.submap(from)?);
        self.check_not_apart([into, from])?;
        if session(into) != session(from) {
            return Err(Error::new(format!("submaps {into} and {from} are of two sessions, which stay apart"), "merge submaps of one session"));
        }
        let t_target_source = target.t_map_submap().inv_mul(&source.t_map_submap());
        fuse(&mut target, &source, &t_target_source, &FusionSettings::from(&self.settings));
        self.entries.retain(|entry| entry.id != from);
        self.changed.remove(&from);
        if let Some(entry) = self.entries.iter_mut().find(|entry| entry.id == into) {
            let stored = |node: NodeId, t_submap_lidar: Pose| ScanEntry { node, t_submap_lidar };
            entry.scans = target.scans().iter().map(|scan| stored(scan.node, scan.t_submap_lidar)).collect();
            entry.corrected = target.scans().iter().zip(target.corrected()).map(|(scan, t)| stored(scan.node, *t)).collect();
            entry.travelled = target.travelled();
        }
        self.changed.insert(into, Arc::new(target));
        Ok(Done::default())
    }
}
