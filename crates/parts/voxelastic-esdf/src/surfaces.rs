//! The surfaces of submaps near points that are asked about: tiles of triangles, made when they are first needed.

use crate::triangle_index::{Nearest, TriangleIndex};
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::atlas::{Submap, SubmapId};
use voxelastic::octree::BLOCK_EDGE;
use voxelastic::surface::{MeshOptions, TILE_EDGE, Tile, extract_tiles};

/// A triangle belongs to the tile that has its centre; its corners are at most this many voxels outside.
const OUTSIDE: f64 = BLOCK_EDGE as f64;
/// Tiles of a submap that are kept, beside those that were asked for last.
const MOST_KEPT: usize = 64;

/// The tiles that were made, by submap.
#[derive(Debug, Default)]
pub(crate) struct Surfaces {
    submaps: Mutex<BTreeMap<SubmapId, Made>>,
}

/// Tiles of a submap as it was at a revision.
#[derive(Clone, Debug)]
struct Made {
    revision: Revision,
    tiles: SubmapTiles,
}

/// Of a submap and of its occupancy, which no other submap's has.
type Revision = (u64, u64);

type SubmapTiles = HashMap<Tile, Arc<TriangleIndex>>;

impl Clone for Surfaces {
    /// Without the tiles: they are made again when they are needed.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Surfaces {
    /// Forgets submaps that are no more.
    pub fn retain(&mut self, is_kept: impl Fn(SubmapId) -> bool) {
        self.submaps.get_mut().unwrap_or_else(PoisonError::into_inner).retain(|id, _| is_kept(*id));
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let submaps = self.submaps.lock().unwrap_or_else(PoisonError::into_inner);
        submaps.values().flat_map(|made| made.tiles.values()).map(|tile| tile.bytes()).sum()
    }

    /// The surface of `submap` around balls (centre in metres of the submap frame, radius in metres), with finest voxels of `voxel` metres.
    pub fn near(&self, submap: &Submap, voxel: f64, balls: impl Iterator<Item = ([f64; 3], f64)>) -> NearSurface {
        let edge = f64::from(TILE_EDGE) * BLOCK_EDGE as f64 * voxel;
        let mut wanted: HashSet<Tile> = HashSet::new();
        let mut last = None;
        for (centre, radius) in balls {
            let range = tiles_around(centre, radius + OUTSIDE * voxel, edge);
            if last.replace(range) != Some(range) {
                wanted.extend(tiles_of(range));
            }
        }
        let mut submaps = self.submaps.lock().unwrap_or_else(PoisonError::into_inner);
        let now: Revision = (submap.revision(), submap.occupancy().revision());
        let made = submaps.entry(submap.id()).or_insert_with(|| Made { revision: now, tiles: HashMap::new() });
        if made.revision != now {
            *made = Made { revision: now, tiles: HashMap::new() };
        }
        let mut missing: Vec<Tile> = wanted.iter().filter(|tile| !made.tiles.contains_key(*tile)).copied().collect();
        missing.sort_unstable();
        if !missing.is_empty() {
            let meshes = extract_tiles(submap.tsdf(), voxel as f32, &MeshOptions::default(), &missing);
            let index = meshes.into_par_iter().map(|mesh| Arc::new(TriangleIndex::new(mesh.positions, mesh.triangles)));
            made.tiles.extend(missing.into_iter().zip(index.collect::<Vec<_>>()));
        }
        let tiles: SubmapTiles = wanted.into_iter().filter_map(|tile| Some((tile, made.tiles.get(&tile)?.clone()))).collect();
        if made.tiles.len() > MOST_KEPT.max(2 * tiles.len()) {
            made.tiles.clone_from(&tiles);
        }
        NearSurface { edge, outside: OUTSIDE * voxel, tiles }
    }
}

/// Lowest and highest tile along each axis.
type TileRange = [[i32; 3]; 2];

fn tiles_around(centre: [f64; 3], radius: f64, edge: f64) -> TileRange {
    [-radius, radius].map(|by| centre.map(|c| ((c + by) / edge).floor() as i32))
}

fn tiles_of([low, high]: TileRange) -> impl Iterator<Item = Tile> {
    let axis = move |k: usize| low[k]..=high[k];
    axis(2).flat_map(move |z| axis(1).flat_map(move |y| axis(0).map(move |x| [x, y, z])))
}

/// A part of a submap's surface.
pub(crate) struct NearSurface {
    /// Edge of a tile, metres.
    edge: f64,
    outside: f64,
    tiles: SubmapTiles,
}

impl NearSurface {
    /// The point of the surface that is nearest to `p` (submap frame, metres), and its squared distance; none if none is within `radius` metres.
    pub fn nearest(&self, p: [f64; 3], radius: f64) -> Option<Nearest> {
        let local = p.map(|c| c as f32);
        let mut nearest = Nearest::within((radius * radius) as f32);
        for tile in tiles_of(tiles_around(p, radius + self.outside, self.edge)) {
            if let Some(index) = self.tiles.get(&tile) {
                index.find(local, &mut nearest);
            }
        }
        nearest.is_found().then_some(nearest)
    }
}
