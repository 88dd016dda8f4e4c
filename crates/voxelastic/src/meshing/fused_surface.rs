//! The surface of a map that grows and bends, as tiles: what is kept, and what has to be made again.

use crate::atlas::Atlas;
use crate::atlas::fusion::{Agreement, OneField, PairAgreement};
use crate::surface::{Crumbs, JoinedTiles, Mesh, MeshOptions, Seams, TileIndex, TileSeam, TileSurface, tile_surfaces};
use std::collections::BTreeMap;

/// log2 of the edge of a tile in blocks: 64 finest voxels.
const TILE_SHIFT: u32 = 3;

/// A tile of a [`FusedSurface`]: a name, in an order in which near tiles are near each other.
pub type TileKey = u64;

/// The one surface of an atlas, in tiles of 64 x 64 x 64 finest voxels that are kept: after a scan or a correction only those are made again whose submaps changed
/// or moved there.
///
/// Where tiles meet, they have the same vertices, bit by bit, so that there are no cracks between them; [`mesh`](Self::mesh) joins them. It equals
/// [`Atlas::mesh`] of an atlas that was not changed since the first update, or since the last correction; between corrections, scans are fused as the correction left the submaps.
/// Level of detail applies to the joined mesh alone.
///
/// ```
/// use voxelastic::atlas::Atlas;
/// use voxelastic::meshing::FusedSurface;
/// use voxelastic::surface::MeshOptions;
/// let mut surface = FusedSurface::new(MeshOptions::default());
/// for tile in surface.update(&Atlas::new(0.065)) {
///     println!("{:?}: {} triangles", surface.corner(tile), surface.tile(tile).triangles.len());
/// }
/// ```
#[derive(Debug)]
pub struct FusedSurface {
    options: MeshOptions,
    /// Edge of a finest voxel, metres.
    voxel: f32,
    one: OneField,
    index: TileIndex,
    tiles: BTreeMap<TileKey, Kept>,
    crumbs: Crumbs,
}

/// A tile that was made, and which of its pieces stay.
#[derive(Debug)]
struct Kept {
    surface: TileSurface,
    stays: Vec<bool>,
}

impl FusedSurface {
    /// Nothing yet.
    pub fn new(options: MeshOptions) -> Self {
        Self { options, voxel: 0.0, one: OneField::default(), index: TileIndex::new(TILE_SHIFT), tiles: BTreeMap::new(), crumbs: Crumbs::default() }
    }

    /// Brings the surface up to date with `atlas`, which must be of the same map as before. Returns the tiles whose surface may be different now, ascending; some of them may
    /// be empty. Runs in parallel; the result does not depend on the number of threads.
    pub fn update(&mut self, atlas: &Atlas) -> Vec<TileKey> {
        self.voxel = atlas.voxel_size();
        let keys = self.one.update(atlas);
        self.index.extend(&self.one.field);
        let changed = self.index.around(&keys);
        for batch in self.index.batches(&changed) {
            let surfaces = tile_surfaces(&self.one.field, self.voxel, &self.options, &self.index, batch);
            for (tile, surface) in batch.iter().zip(surfaces) {
                if surface.mesh.positions.is_empty() {
                    self.tiles.remove(tile);
                } else {
                    self.tiles.insert(*tile, Kept { surface, stays: Vec::new() });
                }
            }
        }
        if changed.is_empty() { changed } else { self.judge(changed) }
    }

    /// Finds out which pieces stay. Adds the tiles for which this is new to `changed`.
    fn judge(&mut self, mut changed: Vec<TileKey>) -> Vec<TileKey> {
        let seams: Vec<TileSeam> = self.tiles.values().map(|kept| TileSeam::from(&kept.surface)).collect();
        let seams = Seams::new(&seams, self.options.keep_all);
        self.crumbs = seams.crumbs;
        for ((tile, kept), stays) in self.tiles.iter_mut().zip(seams.stays) {
            if kept.stays != stays {
                kept.stays = stays;
                changed.push(*tile);
            }
        }
        changed.sort_unstable();
        changed.dedup();
        changed
    }

    /// The tiles that have a surface, ascending.
    pub fn tiles(&self) -> impl Iterator<Item = TileKey> + '_ {
        self.tiles.keys().copied()
    }

    /// The lowest corner of a tile in the map frame, metres. Triangles may reach a voxel beyond a tile.
    pub fn corner(&self, tile: TileKey) -> [f32; 3] {
        self.index.origin(tile).map(|c| c as f32 * self.voxel)
    }

    /// The surface in a tile in metres of the map frame, at full detail; empty if it has none.
    pub fn tile(&self, tile: TileKey) -> Mesh {
        self.tiles.get(&tile).map(|kept| kept.surface.mesh_of(&kept.stays)).unwrap_or_default()
    }

    /// The whole surface as one mesh in metres of the map frame.
    pub fn mesh(&self) -> Mesh {
        let mut joined = JoinedTiles::default();
        self.tiles.values().for_each(|kept| joined.add(&kept.surface));
        joined.finish(&self.options, self.voxel).0
    }

    /// What was merged and what contradicts.
    pub fn agreement(&self) -> Agreement {
        self.one.agreement()
    }

    /// The same by pairs of [`Atlas::tsdfs`] that have surfaces in the same places, as of the last correction.
    pub fn pairs(&self) -> &[PairAgreement] {
        &self.one.pairs
    }

    /// Pieces that are left out because they have too little evidence.
    pub fn crumbs(&self) -> Crumbs {
        self.crumbs
    }
}
