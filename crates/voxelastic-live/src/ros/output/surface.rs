//! The surface as messages, tile by tile.

use crate::ros::messages::{MeshMarker, Rgb};
use crate::tiles::{ChangedTiles, all_submaps};
use std::collections::HashMap;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::surface::{Mesh, Tile};
use voxelastic::{Mapper, Pose};

/// A submap that moved less than this since its tiles were sent is not sent again: metres, and radians.
const SMALLEST_MOVE: [f64; 2] = [0.01, 0.002];
/// Colour of a surface that has none.
const PLAIN: Rgb = [186, 196, 206];

/// Which tiles listeners have, and where.
pub struct SurfaceTiles {
    tiles: ChangedTiles,
    fusions: usize,
    listeners: [usize; 2],
    /// The poses with which tiles were sent.
    sent_at: HashMap<SubmapId, Pose>,
    /// The numbers of the tiles that listeners have, by submap.
    ids: HashMap<SubmapId, HashMap<Tile, i32>>,
}

/// Tiles to send.
#[derive(Debug, Default)]
pub struct Meshes {
    /// A mesh in the map frame for each tile; one without triangles is removed.
    pub markers: Vec<MeshMarker>,
    vertices: Vec<([f32; 3], Rgb)>,
}

impl Meshes {
    /// The vertices, metres in the map frame, and their colours.
    pub fn vertices(&self) -> (Vec<[f32; 3]>, Vec<Rgb>) {
        self.vertices.iter().copied().unzip()
    }
}

impl SurfaceTiles {
    /// None yet.
    pub fn new(detail: usize) -> Self {
        Self { tiles: ChangedTiles::new(detail), fusions: 0, listeners: [0; 2], sent_at: HashMap::new(), ids: HashMap::new() }
    }

    /// Notes what has changed in the map.
    pub fn note(&mut self, mapper: &Mapper) {
        let counts = mapper.elastic_counts();
        let merged = counts.fusions_due > 0 || std::mem::replace(&mut self.fusions, counts.fusions) != counts.fusions;
        self.tiles.note(mapper.atlas(), merged);
    }

    /// Makes some tiles: those that changed, all of submaps that moved, and all of them when there are more listeners than before. None if none is due, or
    /// nobody listens.
    pub fn step(&mut self, atlas: &Atlas, listeners: [usize; 2]) -> Option<Meshes> {
        let before = std::mem::replace(&mut self.listeners, listeners);
        if listeners == [0; 2] {
            return None;
        }
        if listeners.iter().zip(before).any(|(now, before)| *now > before) {
            self.tiles.repeat(|_| true);
        }
        let gone = self.remove_gone(atlas);
        let moved: Vec<SubmapId> = placed(atlas).filter(|(submap, pose)| self.has_moved(submap.id(), pose)).map(|(submap, _)| submap.id()).collect();
        self.tiles.repeat(|id| moved.contains(&id));
        for id in moved {
            self.sent_at.remove(&id);
        }
        let poses: HashMap<SubmapId, Pose> = placed(atlas).map(|(submap, pose)| (submap.id(), pose)).collect();
        let made = self.tiles.step(atlas, |submap, tile, mesh| {
            let pose = poses.get(&submap.id()).copied().unwrap_or_default();
            (submap.id(), tile, Placed::of(&mesh, &pose))
        });
        if made.is_none() && gone.is_empty() {
            return None;
        }
        let mut meshes = Meshes { markers: gone, vertices: Vec::new() };
        for (submap, tile, placed) in made.into_iter().flatten() {
            if let Some(pose) = poses.get(&submap) {
                self.sent_at.entry(submap).or_insert(*pose);
            }
            let ids = self.ids.entry(submap).or_default();
            let next = ids.len() as i32;
            let id = *ids.entry(tile).or_insert(next);
            meshes.vertices.extend(placed.vertices);
            meshes.markers.push(MeshMarker { namespace: namespace(submap), id, corners: placed.corners });
        }
        Some(meshes)
    }

    fn has_moved(&self, id: SubmapId, pose: &Pose) -> bool {
        self.sent_at.get(&id).is_some_and(|sent| {
            let step = sent.inv_mul(pose);
            step.translation.vector.norm() > SMALLEST_MOVE[0] || step.rotation.angle() > SMALLEST_MOVE[1]
        })
    }

    /// Markers that remove the tiles of submaps that are gone.
    fn remove_gone(&mut self, atlas: &Atlas) -> Vec<MeshMarker> {
        let gone: Vec<SubmapId> = self.ids.keys().copied().filter(|id| !all_submaps(atlas).any(|submap| submap.id() == *id)).collect();
        gone.into_iter().flat_map(|id| self.remove(id)).collect()
    }

    fn remove(&mut self, submap: SubmapId) -> Vec<MeshMarker> {
        self.sent_at.remove(&submap);
        let ids = self.ids.remove(&submap).unwrap_or_default();
        ids.into_values().map(|id| MeshMarker { namespace: namespace(submap), id, corners: Vec::new() }).collect()
    }

    /// Markers that remove everything.
    pub fn removed(&mut self) -> Vec<MeshMarker> {
        let all: Vec<SubmapId> = self.ids.keys().copied().collect();
        all.into_iter().flat_map(|id| self.remove(id)).collect()
    }
}

fn namespace(submap: SubmapId) -> String {
    format!("submap {submap}")
}

/// All submaps with their poses in the map frame.
fn placed(atlas: &Atlas) -> impl Iterator<Item = (&Submap, Pose)> {
    let merging = atlas.merging().map(|merging| (merging.submap, merging.t_map_submap));
    atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap())).chain(merging)
}

/// A tile in the map frame.
struct Placed {
    vertices: Vec<([f32; 3], Rgb)>,
    corners: Vec<([f32; 3], Rgb)>,
}

impl Placed {
    fn of(mesh: &Mesh, pose: &Pose) -> Self {
        let colour = |k: usize| match (mesh.colours.get(k), mesh.intensities.get(k)) {
            (Some(colour), _) => *colour,
            (None, Some(intensity)) => [*intensity; 3],
            (None, None) => PLAIN,
        };
        let place = |p: &[f32; 3]| <[f64; 3]>::from((pose * nalgebra::Point3::from(p.map(f64::from))).coords).map(|c| c as f32);
        let vertices: Vec<_> = mesh.positions.iter().enumerate().map(|(k, p)| (place(p), colour(k))).collect();
        let corners = mesh.triangles.iter().flatten().filter_map(|k| vertices.get(*k as usize).copied()).collect();
        Self { vertices, corners }
    }
}
