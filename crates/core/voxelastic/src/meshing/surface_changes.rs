//! Which tiles of the one surface are out of date, and a copy of what they are made of.

use crate::atlas::fusion::{CUBE_SHIFT, Gathered, LiveField, cubes_between};
use crate::atlas::{Atlas, SubmapId};
use crate::meshing::TileKey;
use crate::surface::TileIndex;
use hashbrown::HashSet;
use std::collections::{BTreeMap, BTreeSet};

/// log2 of the edge of a tile in blocks: 64 finest voxels.
pub(super) const TILE_SHIFT: u32 = 3;

/// Keeps track of a map that grows and bends, for a [`TileMaker`](super::TileMaker) that may be on another thread: which tiles of the one surface are out of date.
/// Tiles are cubes of 64 x 64 x 64 finest voxels of the map frame.
///
/// ```
/// use voxelastic::atlas::Atlas;
/// use voxelastic::meshing::{SurfaceChanges, TileMaker};
/// use voxelastic::surface::MeshOptions;
/// let (atlas, mut changes, mut maker) = (Atlas::new(0.065), SurfaceChanges::default(), TileMaker::new(MeshOptions::default()));
/// changes.note(&atlas);
/// let some: Vec<_> = changes.waiting().take(16).collect();
/// let work = changes.gather(&atlas, &some);
/// // The map may change meanwhile.
/// let made = std::thread::spawn(move || maker.make(&work)).join().unwrap();
/// changes.wait_for(&made.again);
/// ```
#[derive(Debug)]
pub struct SurfaceChanges {
    /// Edge of a finest voxel, metres.
    voxel: f32,
    live: LiveField,
    index: TileIndex,
    waiting: BTreeSet<TileKey>,
}

/// A copy of what some tiles are made of.
#[derive(Debug)]
pub struct TileWork {
    pub(super) voxel: f32,
    pub(super) gathered: Gathered,
    /// Ascending.
    pub(super) tiles: Vec<TileKey>,
}

impl TileWork {
    /// The tiles, ascending.
    pub fn tiles(&self) -> &[TileKey] {
        &self.tiles
    }
}

impl Default for SurfaceChanges {
    fn default() -> Self {
        Self { voxel: 0.0, live: LiveField::default(), index: TileIndex::new(TILE_SHIFT), waiting: BTreeSet::new() }
    }
}

impl SurfaceChanges {
    /// Finds out which tiles are out of date, after anything changed in the map. `atlas` must be of the same map as before.
    pub fn note(&mut self, atlas: &Atlas) {
        self.voxel = atlas.voxel_size();
        self.index.set_coloured(atlas.tsdfs().iter().any(|(field, _)| !field.colours().is_empty()));
        let near = self.live.note(atlas, TILE_SHIFT, self.index.margin());
        let live = &self.live;
        let is_there = |tile: &TileKey| cubes_in(*tile).any(|cube| live.is_stale(cube)) || live.parts(cubes_in(*tile)).next().is_some();
        self.waiting.extend(near.into_iter().filter(is_there));
    }

    /// Bends submaps onto each other as a mesh of the whole map does, until a correction moves them, and finds out which tiles that changes. All of the map is looked at, which
    /// takes a second for a large one: it is for a map that does not change any more.
    pub fn settle(&mut self, atlas: &Atlas) {
        let near = self.live.settle(atlas, TILE_SHIFT, self.index.margin());
        self.waiting.extend(near);
    }

    /// The tiles that are out of date, ascending.
    pub fn waiting(&self) -> impl Iterator<Item = TileKey> + '_ {
        self.waiting.iter().copied()
    }

    /// Some tiles are out of date again.
    pub fn wait_for(&mut self, tiles: &[TileKey]) {
        self.waiting.extend(tiles);
    }

    /// Copies what some tiles, ascending, and the blocks around them are made of, as far as it changed since it was copied last. The atlas is that of the last
    /// [`note`](Self::note). The tiles do not wait any more. What is gathered is to be made in the same order.
    pub fn gather(&mut self, atlas: &Atlas, tiles: &[TileKey]) -> TileWork {
        let edge = (1 << TILE_SHIFT) - 1;
        let around = |tile: &TileKey| {
            let low = self.index.corner(*tile);
            cubes_between(low, low.map(|c| c + edge), self.index.margin(), CUBE_SHIFT)
        };
        let cubes: HashSet<u64> = tiles.iter().flat_map(around).collect();
        self.waiting.retain(|tile| tiles.binary_search(tile).is_err());
        TileWork { voxel: self.voxel, gathered: self.live.gather(atlas, &cubes), tiles: tiles.to_vec() }
    }

    /// The place of a tile among all, in tiles: one with `x` one higher is the next along x.
    pub fn place(&self, tile: TileKey) -> [i32; 3] {
        self.index.place(tile)
    }

    /// The lowest corner of a tile in the map frame, metres. Triangles may reach a voxel beyond a tile.
    pub fn corner(&self, tile: TileKey) -> [f32; 3] {
        self.index.origin(tile).map(|c| c as f32 * self.voxel)
    }

    /// The tile around a point of the map frame, metres; none before the first [`note`](Self::note), and for points that are too far away.
    pub fn tile_at(&self, point: [f32; 3]) -> Option<TileKey> {
        self.index.tile_at(point.map(|c| c / self.voxel))
    }

    /// The submap that has most of a tile, of several the newest, which is where the robot is; none if none has a part of it.
    pub fn carrier(&self, tile: TileKey) -> Option<SubmapId> {
        let mut blocks: BTreeMap<SubmapId, usize> = BTreeMap::new();
        self.live.parts(cubes_in(tile)).for_each(|(id, count)| *blocks.entry(id).or_default() += count);
        blocks.into_iter().max_by_key(|(id, count)| (*count, *id)).map(|(id, _)| id)
    }
}

/// The cubes in a tile.
fn cubes_in(tile: TileKey) -> impl Iterator<Item = u64> + Clone {
    let bits = 3 * (TILE_SHIFT - CUBE_SHIFT);
    (0..1 << bits).map(move |i| tile << bits | i)
}
