//! The surface as messages, tile by tile.

use crate::ros::messages::{MeshMarker, Rgb};
use crate::tiles::{ChangedTiles, OrderedTile};
use std::collections::HashMap;
use voxelastic::Mapper;
use voxelastic::atlas::Atlas;
use voxelastic::surface::Mesh;

/// Colour of a surface that has none.
const PLAIN: Rgb = [186, 196, 206];
const NAMESPACE: &str = "surface";

/// Which tiles listeners have.
pub struct SurfaceTiles {
    detail: usize,
    /// While somebody listens: it holds the fused surface.
    tiles: Option<ChangedTiles<([i32; 3], Placed)>>,
    listeners: [usize; 2],
    /// The numbers of the tiles that listeners have, by place.
    ids: HashMap<[i32; 3], i32>,
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
        Self { detail, tiles: None, listeners: [0; 2], ids: HashMap::new() }
    }

    /// Notes what has changed in the map.
    pub fn note(&mut self, mapper: &Mapper) {
        if let Some(tiles) = &mut self.tiles {
            tiles.note(mapper.atlas());
        }
    }

    /// What is near a position in the map frame, metres, is made first.
    pub fn focus(&mut self, position: [f32; 3]) {
        if let Some(tiles) = &mut self.tiles {
            tiles.focus(position);
        }
    }

    /// Takes the tiles that were made, and has others made on another thread: those that changed or whose submaps moved, and all of them when there are more listeners than
    /// before. None if there are none, or nobody listens.
    pub fn step(&mut self, atlas: &Atlas, listeners: [usize; 2]) -> Option<Meshes> {
        let before = std::mem::replace(&mut self.listeners, listeners);
        if listeners == [0; 2] {
            self.tiles = None;
            return None;
        }
        let mut meshes = Meshes::default();
        let tiles = match &mut self.tiles {
            Some(tiles) => tiles,
            tiles => {
                // Of those who listened before, somebody may still have what is not there any more.
                meshes.markers = Self::removal(&mut self.ids);
                let tiles = tiles.insert(ChangedTiles::new(self.detail));
                tiles.note(atlas);
                tiles
            }
        };
        if listeners.iter().zip(before).any(|(now, before)| *now > before) {
            tiles.repeat();
        }
        let made = tiles.step(atlas, |tile: &OrderedTile, mesh| (tile.place, Placed::of(&mesh)));
        if made.is_none() && meshes.markers.is_empty() {
            return None;
        }
        for (place, placed) in made.into_iter().flatten() {
            let next = self.ids.len() as i32;
            let id = *self.ids.entry(place).or_insert(next);
            meshes.vertices.extend(placed.vertices);
            meshes.markers.push(MeshMarker { namespace: NAMESPACE.to_owned(), id, corners: placed.corners });
        }
        Some(meshes)
    }

    /// Whether tiles are being made.
    pub fn is_busy(&self) -> bool {
        self.tiles.as_ref().is_some_and(ChangedTiles::is_busy)
    }

    fn removal(ids: &mut HashMap<[i32; 3], i32>) -> Vec<MeshMarker> {
        std::mem::take(ids).into_values().map(|id| MeshMarker { namespace: NAMESPACE.to_owned(), id, corners: Vec::new() }).collect()
    }

    /// Markers that remove everything.
    pub fn removed(&mut self) -> Vec<MeshMarker> {
        Self::removal(&mut self.ids)
    }
}

/// A tile in the map frame.
struct Placed {
    vertices: Vec<([f32; 3], Rgb)>,
    corners: Vec<([f32; 3], Rgb)>,
}

impl Placed {
    fn of(mesh: &Mesh) -> Self {
        let colour = |k: usize| match (mesh.colours.get(k), mesh.intensities.get(k)) {
            (Some(colour), _) => *colour,
            (None, Some(intensity)) => [*intensity; 3],
            (None, None) => PLAIN,
        };
        let vertices: Vec<_> = mesh.positions.iter().enumerate().map(|(k, p)| (*p, colour(k))).collect();
        let corners = mesh.triangles.iter().flatten().filter_map(|k| vertices.get(*k as usize).copied()).collect();
        Self { vertices, corners }
    }
}
