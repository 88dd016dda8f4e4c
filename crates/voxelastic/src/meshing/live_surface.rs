//! The one surface of a map while it grows and bends, a few tiles at a time.

use super::surface_changes::SurfaceChanges;
use super::tile_maker::TileMaker;
use crate::atlas::{Atlas, SubmapId};
use crate::meshing::TileKey;
use crate::surface::{Mesh, MeshOptions};

/// The one surface of an atlas, for those who show it while the map is made: [`note`](Self::note) finds out which tiles are out of date, and [`make`](Self::make) makes
/// some of them, so that its caller decides how long that takes and what comes first. Tiles are cubes of 64 x 64 x 64 finest voxels of the map frame. Its two halves,
/// [`SurfaceChanges`] and [`TileMaker`], may be on two threads, so that scans do not wait while tiles are made.
///
/// Overlapping submaps are fused as by [`Atlas::mesh`], and crumbs left out, with three differences. Submaps are bent as corrections moved their scans, but onto each other only
/// by [`settle`](Self::settle). A single submap is resampled, too. And whether a piece has enough evidence is told by its tile and those around.
///
/// Meshes are not kept. Once no tile waits, tiles fit together without cracks, at any level of detail.
///
/// ```
/// use voxelastic::atlas::Atlas;
/// use voxelastic::meshing::LiveSurface;
/// use voxelastic::surface::MeshOptions;
/// let (atlas, mut surface) = (Atlas::new(0.065), LiveSurface::new(MeshOptions::default()));
/// surface.note(&atlas);
/// let some: Vec<_> = surface.waiting().take(16).collect();
/// for (tile, mesh) in surface.make(&atlas, &some) {
///     println!("{:?}: {} triangles", surface.place(tile), mesh.triangles.len());
/// }
/// ```
#[derive(Debug)]
pub struct LiveSurface {
    lod: usize,
    changes: SurfaceChanges,
    maker: TileMaker,
}

impl LiveSurface {
    /// Nothing yet.
    pub fn new(options: MeshOptions) -> Self {
        Self { lod: options.lod, changes: SurfaceChanges::default(), maker: TileMaker::new(options) }
    }

    /// The level of detail.
    pub fn lod(&self) -> usize {
        self.lod
    }

    /// Finds out which tiles are out of date, after anything changed in the map. `atlas` must be of the same map as before.
    pub fn note(&mut self, atlas: &Atlas) {
        self.changes.note(atlas);
    }

    /// Bends submaps onto each other as [`Atlas::mesh`] does, until a correction moves them. All of the map is looked at, which takes a second for a large one: it is for a map
    /// that does not change any more.
    pub fn settle(&mut self, atlas: &Atlas) {
        self.changes.settle(atlas);
    }

    /// The tiles that are out of date, ascending.
    pub fn waiting(&self) -> impl Iterator<Item = TileKey> + '_ {
        self.changes.waiting()
    }

    /// Makes some tiles, ascending, from the atlas of the last [`note`](Self::note), in metres of the map frame; they do not wait any more. Empty ones are returned, too.
    /// Runs in parallel; the result does not depend on the number of threads.
    pub fn make(&mut self, atlas: &Atlas, tiles: &[TileKey]) -> Vec<(TileKey, Mesh)> {
        let made = self.maker.make(&self.changes.gather(atlas, tiles));
        self.changes.wait_for(&made.again);
        made.meshes
    }

    /// The place of a tile among all, in tiles: one with `x` one higher is the next along x.
    pub fn place(&self, tile: TileKey) -> [i32; 3] {
        self.changes.place(tile)
    }

    /// The lowest corner of a tile in the map frame, metres. Triangles may reach a voxel beyond a tile.
    pub fn corner(&self, tile: TileKey) -> [f32; 3] {
        self.changes.corner(tile)
    }

    /// The tile around a point of the map frame, metres; none before the first [`note`](Self::note), and for points that are too far away.
    pub fn tile_at(&self, point: [f32; 3]) -> Option<TileKey> {
        self.changes.tile_at(point)
    }

    /// The submap that has most of a tile, if any has a part of it.
    pub fn carrier(&self, tile: TileKey) -> Option<SubmapId> {
        self.changes.carrier(tile)
    }

    /// Memory of the fused field, bytes.
    pub fn bytes(&self) -> usize {
        self.maker.bytes()
    }
}
