//! The one surface of a map while it grows and bends, a few tiles at a time.

use crate::atlas::fusion::{LiveField, neighbours};
use crate::atlas::{Atlas, SubmapId};
use crate::meshing::TileKey;
use crate::surface::{Mesh, MeshOptions, Seams, TileIndex, TileSeam, TileSurface, tile_surfaces};
use hashbrown::HashMap;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// log2 of the edge of a tile in blocks: 64 finest voxels.
const TILE_SHIFT: u32 = 3;

/// The one surface of an atlas, for those who show it while the map is made: [`note`](Self::note) finds out which tiles are out of date, and [`make`](Self::make) makes
/// some of them, so that its caller decides how long that takes and what comes first. Tiles are cubes of 64 x 64 x 64 finest voxels of the map frame.
///
/// Overlapping submaps are fused as by [`Atlas::mesh`], and crumbs left out, with two differences. Submaps are bent as corrections moved their scans, but not onto each other:
/// for that, all of the map must be looked at. And whether a piece has enough evidence is told by its tile and those around.
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
    options: MeshOptions,
    /// Edge of a finest voxel, metres.
    voxel: f32,
    live: LiveField,
    index: TileIndex,
    /// Of the tiles that have a surface.
    seams: HashMap<TileKey, Judged>,
    waiting: BTreeSet<TileKey>,
}

/// How a tile fits to others, and which of its pieces stay, as it was made last.
#[derive(Debug)]
struct Judged {
    seam: TileSeam,
    stays: Vec<bool>,
}

impl LiveSurface {
    /// Nothing yet.
    pub fn new(options: MeshOptions) -> Self {
        let (live, index) = (LiveField::default(), TileIndex::new(TILE_SHIFT));
        Self { options, voxel: 0.0, live, index, seams: HashMap::new(), waiting: BTreeSet::new() }
    }

    /// The level of detail.
    pub fn lod(&self) -> usize {
        self.options.lod
    }

    /// Finds out which tiles are out of date, after anything changed in the map. `atlas` must be of the same map as before.
    pub fn note(&mut self, atlas: &Atlas) {
        self.voxel = atlas.voxel_size();
        let near = self.live.note(atlas, self.index.margin());
        let (live, index) = (&self.live, &self.index);
        self.waiting.extend(near.into_iter().filter(|tile| live.is_stale(*tile) || index.contains(*tile)));
    }

    /// The tiles that are out of date, ascending.
    pub fn waiting(&self) -> impl Iterator<Item = TileKey> + '_ {
        self.waiting.iter().copied()
    }

    /// Makes some tiles, ascending, from the atlas of the last [`note`](Self::note), in metres of the map frame; they do not wait any more. Empty ones are returned, too.
    /// Runs in parallel; the result does not depend on the number of threads.
    pub fn make(&mut self, atlas: &Atlas, tiles: &[TileKey]) -> Vec<(TileKey, Mesh)> {
        let mut around: Vec<TileKey> = tiles.iter().flat_map(|tile| neighbours(*tile).chain([*tile])).collect();
        around.sort_unstable();
        around.dedup();
        // What is around is up to date when a tile is made, so that it need not be made again because of that.
        self.live.renew(atlas, &around);
        let field = self.live.field();
        self.index.extend(field);
        let surfaces = tile_surfaces(field, self.voxel, &self.options, &self.index, tiles);
        for (tile, surface) in tiles.iter().zip(&surfaces) {
            self.waiting.remove(tile);
            if surface.mesh.triangles.is_empty() {
                self.seams.remove(tile);
            } else {
                let seam = TileSeam::from(surface);
                // Of a tile that is as it was, what had enough evidence has it still, whatever is looked at now: else two tiles could have each other made for ever.
                let before = self.seams.remove(tile).filter(|before| before.seam == seam);
                self.seams.insert(*tile, Judged { seam, stays: before.map_or_else(Vec::new, |before| before.stays) });
            }
        }
        self.judge(tiles, &around);
        let finish = |(tile, surface): (&TileKey, &TileSurface)| {
            let stays = self.seams.get(tile).map_or(&[][..], |judged| &judged.stays);
            (*tile, surface.coarse_mesh_of(stays, self.voxel, self.options.lod))
        };
        tiles.par_iter().zip(&surfaces).map(finish).collect()
    }

    /// Finds out which pieces of `tiles` stay, by what is `around`. Where a piece that was left out has enough evidence now, its tile waits again.
    fn judge(&mut self, tiles: &[TileKey], around: &[TileKey]) {
        let there: Vec<(TileKey, &TileSeam)> = around.iter().filter_map(|tile| Some((*tile, &self.seams.get(tile)?.seam))).collect();
        let seams = Seams::new(&there.iter().map(|(_, seam)| *seam).collect::<Vec<_>>(), self.options.keep_all);
        let there: Vec<TileKey> = there.into_iter().map(|(tile, _)| tile).collect();
        for (tile, mut stays) in there.into_iter().zip(seams.stays) {
            let Some(judged) = self.seams.get_mut(&tile) else { continue };
            let is_made = tiles.binary_search(&tile).is_ok();
            if !is_made && stays.iter().zip(&judged.stays).any(|(now, before)| *now && !before) {
                self.waiting.insert(tile);
            }
            stays.iter_mut().zip(&judged.stays).for_each(|(now, before)| *now |= before);
            judged.stays = stays;
        }
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

    /// The submap that has most of a tile, if any has a part of it.
    pub fn carrier(&self, tile: TileKey) -> Option<SubmapId> {
        self.live.carrier(tile)
    }

    /// Memory of the fused field, bytes.
    pub fn bytes(&self) -> usize {
        self.live.field().bytes()
    }
}
