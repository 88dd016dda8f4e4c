//! From the mapper to the scene that viewers show.

use crate::scene::{Scene, Thing};
use crate::tiles::{ChangedTiles, OrderedTile, all_submaps};
use crate::wire::{self, NO_SUBMAP, Place};
use std::collections::HashMap;
use std::sync::Arc;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::event::NodeId;
use voxelastic::geometry::Rigid;
use voxelastic::surface::Mesh;
use voxelastic::{Cloud, Mapper, Pose};

/// Positions of the trajectory in a message.
const PART: usize = 256;
/// Most points of a scan that are shown.
const POINTS: usize = 8192;
/// Over a link of limited rate, every so many of them.
const OVER_LINK: usize = 8;

/// The points of a scan that viewers show: every so many of the returns, lidar frame, metres.
#[derive(Clone, Debug, Default)]
pub struct ShownScan {
    points: Vec<[f32; 3]>,
    time: f64,
}

impl ShownScan {
    /// Of a cloud taken at `time` seconds.
    pub fn of(cloud: &Cloud, time: f64) -> Self {
        let step = cloud.points.len().div_ceil(POINTS).max(1);
        let is_return = |p: &&[f32; 3]| p.iter().all(|c| c.is_finite()) && p.iter().any(|c| *c != 0.0);
        Self { points: cloud.points.iter().step_by(step).filter(is_return).copied().collect(), time }
    }
}

/// Tells viewers what changed. It is called by the mapper's thread and never waits for a viewer.
#[derive(Debug)]
pub struct Publisher {
    scene: Arc<Scene>,
    tiles: ChangedTiles<([i32; 3], Vec<u8>)>,
    /// The poses that viewers have.
    poses: Vec<(SubmapId, Pose)>,
    /// The trajectory that viewers have, and the number of scans of each submap in it.
    path: Vec<Place>,
    nodes: HashMap<NodeId, usize>,
    scans: HashMap<SubmapId, usize>,
    loops: Vec<[NodeId; 2]>,
    /// The loops that viewers have.
    pairs: Vec<[Place; 2]>,
}

impl Publisher {
    /// One that tells `scene`; `lod` is the level of detail of the surface, 0 to 3.
    pub fn new(scene: Arc<Scene>, lod: usize) -> Self {
        let tiles = ChangedTiles::new(lod);
        Self { scene, tiles, poses: Vec::new(), path: Vec::new(), nodes: HashMap::new(), scans: HashMap::new(), loops: Vec::new(), pairs: Vec::new() }
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Forgets the map, which begins anew.
    pub fn reset(&mut self) {
        self.scene.clear();
        *self = Self::new(Arc::clone(&self.scene), self.tiles.lod());
    }

    /// Adds a loop between two nodes.
    pub fn add_loop(&mut self, from: NodeId, to: NodeId) {
        self.loops.push([from, to]);
    }

    /// After an event: poses, trajectory, loops and the scan are told at once, surfaces by [`step`](Self::step).
    pub fn note(&mut self, mapper: &Mapper, scan: Option<&ShownScan>) {
        self.note_atlas(mapper.atlas(), scan);
    }

    /// The same of a map without a mapper.
    pub fn note_atlas(&mut self, atlas: &Atlas, scan: Option<&ShownScan>) {
        let mut messages = Vec::new();
        let mut poses: Vec<(SubmapId, Pose)> = atlas.placed().map(|(submap, t_map_submap)| (submap.id(), t_map_submap)).collect();
        // Of those that are gone, tiles may be shown until they are made again.
        let is_shown = |(id, _): &&(SubmapId, Pose)| !poses.iter().any(|(there, _)| there == id) && self.tiles.has_carried(*id);
        let gone: Vec<(SubmapId, Pose)> = self.poses.iter().filter(is_shown).copied().collect();
        poses.extend(gone);
        if poses != self.poses {
            messages.push((Thing::Submaps, wire::submaps(&poses)));
            self.poses = poses;
        }
        self.note_path(atlas, &mut messages);
        self.note_loops(&mut messages);
        self.tiles.note(atlas);
        if let Some(scan) = scan
            && let Some((submap, pose)) = self.newest(atlas)
        {
            let points: Vec<[f32; 3]> = scan.points.iter().step_by(if self.scene.link().is_some() { OVER_LINK } else { 1 }).copied().collect();
            messages.push((Thing::Scan, wire::scan(self.path.len() as u32, scan.time, submap, &pose, &points)));
            if let Some((_, t_map_submap)) = self.poses.iter().find(|(id, _)| *id == submap) {
                let place = self.tiles.focus(<[f64; 3]>::from((t_map_submap * pose).translation.vector).map(|c| c as f32));
                place.into_iter().for_each(|place| self.scene.focus(place));
            }
        }
        self.scene.put(messages);
    }

    /// Adds scans to the trajectory, and moves those whose submap was fused into another.
    fn note_path(&mut self, atlas: &Atlas, messages: &mut Vec<(Thing, Vec<u8>)>) {
        let mut parts = std::collections::BTreeSet::new();
        for submap in atlas.submaps() {
            let known = self.scans.insert(submap.id(), submap.scans().len()).unwrap_or(0);
            // A fusion inserts scans anywhere: then all are looked at.
            let from = if submap.scans().len() <= known + 1 { known.min(submap.scans().len()) } else { 0 };
            for scan in &submap.scans()[from..] {
                let position = <[f64; 3]>::from(scan.t_submap_lidar.translation.vector).map(|c| c as f32);
                let place = Place { submap: submap.id(), position };
                let index = *self.nodes.entry(scan.node).or_insert_with(|| {
                    self.path.push(Place { submap: SubmapId::MAX, position });
                    self.path.len() - 1
                });
                if self.path[index] != place {
                    self.path[index] = place;
                    parts.insert(index / PART);
                }
            }
        }
        let message = |part: &usize| (Thing::Path(*part as u32), wire::path(*part as u32, self.path.chunks(PART).nth(*part).unwrap_or_default()));
        messages.extend(parts.iter().map(message));
    }

    fn note_loops(&mut self, messages: &mut Vec<(Thing, Vec<u8>)>) {
        let place = |node: &NodeId| self.nodes.get(node).map(|i| self.path[*i]);
        let pairs: Vec<[Place; 2]> = self.loops.iter().filter_map(|[a, b]| Some([place(a)?, place(b)?])).collect();
        if pairs != self.pairs {
            messages.push((Thing::Loops, wire::loops(&pairs)));
            self.pairs = pairs;
        }
    }

    /// The submap with the newest scan, and the pose of the lidar in it.
    fn newest(&self, atlas: &Atlas) -> Option<(SubmapId, Pose)> {
        let newest = |submap: &&Submap| submap.scans().last().and_then(|scan| self.nodes.get(&scan.node));
        let submap = all_submaps(atlas).max_by_key(newest)?;
        Some((submap.id(), submap.scans().last()?.t_submap_lidar))
    }

    /// Tells viewers about the tiles that were made since the last call, and has others that changed made on another thread; false if there are none to tell about. It waits
    /// for nothing. To be called in the mapper's threads.
    pub fn step(&mut self, atlas: &Atlas) -> bool {
        // A tile moves with a submap until it is made again, so that a correction is visible at once.
        let poses: HashMap<SubmapId, Rigid> = self.poses.iter().map(|(id, t_map_submap)| (*id, Rigid::from(&t_map_submap.inverse()))).collect();
        let scans = self.path.len() as u32;
        let finish = move |ordered: &OrderedTile, mut mesh: Mesh| {
            let (carrier, t_carrier_map) = ordered.carrier.and_then(|id| poses.get_key_value(&id)).unzip();
            t_carrier_map.into_iter().for_each(|t_carrier_map| mesh.transform(t_carrier_map));
            (ordered.place, wire::tile(carrier.copied().unwrap_or(NO_SUBMAP), ordered.place, scans, mesh))
        };
        let Some(made) = self.tiles.step(atlas, finish) else { return false };
        self.scene.put(made.into_iter().map(|(place, message)| (Thing::Tile(place), message)));
        true
    }

    /// Whether tiles are being made: what they are is told by a [`step`](Self::step) soon.
    pub fn is_busy(&self) -> bool {
        self.tiles.is_busy()
    }

    /// Has submaps bent onto each other, as they are for a mesh of the whole map. That takes its time: it is for a map that does not change any more.
    pub fn settle(&mut self, atlas: &Atlas) {
        self.tiles.settle(atlas);
    }

    /// Whether viewers lack changes of the surface.
    pub fn is_behind(&self) -> bool {
        self.tiles.is_behind()
    }

    /// Tells viewers figures, as a JSON object.
    pub fn statistics(&self, json: &str) {
        self.scene.put([(Thing::Statistics, wire::statistics(json))]);
    }
}
