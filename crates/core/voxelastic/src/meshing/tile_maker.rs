//! Makes tiles of the one surface of what was gathered from a map.

use super::surface_changes::{TILE_SHIFT, TileWork};
use crate::atlas::fusion::{SampledField, cubes_around};
use crate::meshing::TileKey;
use crate::surface::{Mesh, MeshOptions, Seams, TileIndex, TileSeam, TileSurface, tile_surfaces};
use hashbrown::HashMap;
use rayon::prelude::*;

/// Makes the tiles that [`SurfaceChanges`](super::SurfaceChanges) gathered, on any thread: it needs no access to the map.
#[derive(Debug)]
pub struct TileMaker {
    options: MeshOptions,
    sampled: SampledField,
    index: TileIndex,
    /// Of the tiles that have a surface.
    seams: HashMap<TileKey, Judged>,
}

/// Tiles that were made.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct MadeTiles {
    /// The surface in each tile in metres of the map frame, ascending. Some may be empty.
    pub meshes: Vec<(TileKey, Mesh)>,
    /// Other tiles that are out of date now, because a piece of theirs has enough evidence with what is new.
    pub again: Vec<TileKey>,
}

/// How a tile fits to others, and which of its pieces stay, as it was made last.
#[derive(Debug)]
struct Judged {
    seam: TileSeam,
    stays: Vec<bool>,
}

impl TileMaker {
    /// Nothing yet.
    pub fn new(options: MeshOptions) -> Self {
        Self { options, sampled: SampledField::default(), index: TileIndex::new(TILE_SHIFT), seams: HashMap::new() }
    }

    /// Makes tiles. Runs in parallel; the result does not depend on the number of threads.
    pub fn make(&mut self, work: &TileWork) -> MadeTiles {
        // What is around is up to date when a tile is made, so that it need not be made again because of that.
        self.sampled.renew(&work.gathered);
        let field = self.sampled.field();
        self.index.extend(field);
        let surfaces = tile_surfaces(field, work.voxel, &self.options, &self.index, &work.tiles);
        for (tile, surface) in work.tiles.iter().zip(&surfaces) {
            if surface.mesh.triangles.is_empty() {
                self.seams.remove(tile);
            } else {
                let seam = TileSeam::from(surface);
                // Of a tile that is as it was, what had enough evidence has it still, whatever is looked at now: else two tiles could have each other made for ever.
                let before = self.seams.remove(tile).filter(|before| before.seam == seam);
                self.seams.insert(*tile, Judged { seam, stays: before.map_or_else(Vec::new, |before| before.stays) });
            }
        }
        let again = self.judge(&work.tiles);
        let finish = |(tile, surface): (&TileKey, &TileSurface)| {
            let stays = self.seams.get(tile).map_or(&[][..], |judged| &judged.stays);
            (*tile, surface.coarse_mesh_of(stays, work.voxel, self.options.lod))
        };
        MadeTiles { meshes: work.tiles.par_iter().zip(&surfaces).map(finish).collect(), again }
    }

    /// Finds out which pieces of `tiles` stay, by what is around. Returns the tiles there of which a piece that was left out has enough evidence now.
    fn judge(&mut self, tiles: &[TileKey]) -> Vec<TileKey> {
        let mut around: Vec<TileKey> = tiles.iter().flat_map(|tile| cubes_around(*tile, TILE_SHIFT)).collect();
        around.sort_unstable();
        around.dedup();
        let there: Vec<(TileKey, &TileSeam)> = around.into_iter().filter_map(|tile| Some((tile, &self.seams.get(&tile)?.seam))).collect();
        let seams = Seams::new(&there.iter().map(|(_, seam)| *seam).collect::<Vec<_>>(), self.options.keep_all);
        let there: Vec<TileKey> = there.into_iter().map(|(tile, _)| tile).collect();
        let mut again = Vec::new();
        for (tile, mut stays) in there.into_iter().zip(seams.stays) {
            let Some(judged) = self.seams.get_mut(&tile) else { continue };
            let is_made = tiles.binary_search(&tile).is_ok();
            if !is_made && stays.iter().zip(&judged.stays).any(|(now, before)| *now && !before) {
                again.push(tile);
            }
            stays.iter_mut().zip(&judged.stays).for_each(|(now, before)| *now |= before);
            judged.stays = stays;
        }
        again
    }

    /// Memory of the fused field, bytes.
    pub fn bytes(&self) -> usize {
        self.sampled.field().bytes()
    }
}
