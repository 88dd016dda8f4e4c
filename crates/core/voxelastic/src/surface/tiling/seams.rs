//! Which pieces of tiles stay, told from what they have at their borders.

use super::piece_sets::PieceSets;
use super::tile_surface::{TileSurface, VertexKey};
use crate::surface::evidence::{Evidence, SmallComponents};
use hashbrown::HashMap;
use std::borrow::Borrow;

/// What of a tile tells how it fits to others: a small part of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TileSeam {
    /// Vertices of other tiles that it uses, and their pieces.
    foreign: Vec<(VertexKey, u32)>,
    /// Own vertices that others may use, and their pieces.
    border: Vec<(VertexKey, u32)>,
    pieces: Vec<Evidence>,
}

impl From<&TileSurface> for TileSeam {
    fn from(tile: &TileSurface) -> Self {
        let foreign = tile.foreign.iter().copied().zip(tile.piece_of[tile.own()..].iter().copied()).collect();
        let border = tile.border.iter().map(|&(key, v)| (key, tile.piece_of[v as usize])).collect();
        Self { foreign, border, pieces: tile.pieces.clone() }
    }
}

/// How tiles fit together.
pub(crate) struct Seams {
    /// By tile, whether each of its pieces stays.
    pub stays: Vec<Vec<bool>>,
    /// The pieces that do not.
    pub small_components: SmallComponents,
}

impl Seams {
    /// Finds out how `tiles` fit together, which must be all tiles of a surface; with `keep_all` all pieces stay.
    pub fn new<T: Borrow<TileSeam>>(tiles: &[T], keep_all: bool) -> Self {
        let tiles: Vec<&TileSeam> = tiles.iter().map(T::borrow).collect();
        let mut border = HashMap::with_capacity(tiles.iter().map(|tile| tile.border.len()).sum());
        let (mut sets, mut firsts) = (PieceSets::default(), Vec::with_capacity(tiles.len()));
        for tile in &tiles {
            let first = sets.add(&tile.pieces);
            border.extend(tile.border.iter().map(|&(key, piece)| (key, first + piece)));
            firsts.push(first);
        }
        for (tile, first) in tiles.iter().zip(&firsts) {
            for (key, piece) in &tile.foreign {
                if let Some(&there) = border.get(key) {
                    sets.connect(first + piece, there);
                }
            }
        }
        let (all, small_components) = sets.judge(keep_all);
        let stays = tiles.iter().zip(firsts).map(|(tile, first)| all[first as usize..][..tile.pieces.len()].to_vec());
        Self { stays: stays.collect(), small_components }
    }
}
