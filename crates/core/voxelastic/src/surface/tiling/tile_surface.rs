//! The surface in cubes of the octree, each with what is needed to join them: names of the vertices at its border, and its pieces with their evidence.
//!
//! A triangle belongs to the tile of the block that owns its cell, and a vertex to that of the voxel that owns it. What lies at a border is computed from blocks of
//! both sides, with the same bits whichever tile asks, so that tiles can be made one by one and joined without cracks. Tiles are cubes of the octree: in
//! Morton order their blocks follow each other, so that the joined mesh does not depend on the size of tiles.

use crate::field::tsdf::TsdfField;
use crate::memory::budget;
use crate::octree::{BLOCK_EDGE, MAX_BLOCK_COORD, SCALES, block_coords, block_key};
use crate::surface::blocks::block_grid::{BlockGrid, PART, part_of};
use crate::surface::blocks::block_masks::coords;
use crate::surface::blocks::resolved_blocks::ResolvedBlocks;
use crate::surface::evidence::{Evidence, pieces_of};
use crate::surface::extract::{MeshOptions, extract_blocks};
use crate::surface::marching_cubes::mesh_part::{BlockVertices, MeshPart};
use crate::surface::marching_cubes::vertices::mask_index;
use crate::surface::mesh::Mesh;
use crate::surface::simplify::simplify;
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;
use std::ops::Range;

/// The mesh of a block depends on the blocks this far around it.
const MARGIN: i32 = 2;
/// The same if there are colours, which spread over four edges into what has none; an edge may be a block long.
const COLOUR_MARGIN: i32 = 6;
/// Blocks that are extracted together, about: with what is around them they take some tens of megabytes.
const BATCH: usize = 1 << 15;
/// The same under a memory budget.
const SMALL_BATCH: usize = 1 << 13;

/// A vertex by the block, the word and the bit that own it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct VertexKey {
    block: u64,
    word: u8,
    bit: u8,
}

/// The surface in one tile.
#[derive(Clone, Debug, Default)]
pub(crate) struct TileSurface {
    /// First its own vertices, in the order of their names, then copies of those of other tiles that its triangles use. Units are those of the field.
    pub mesh: Mesh,
    /// Names of the copies, ascending.
    pub foreign: Vec<VertexKey>,
    /// Own vertices that other tiles may use, ascending.
    pub border: Vec<(VertexKey, u32)>,
    /// The piece of each vertex, and the evidence of each piece in this tile.
    pub piece_of: Vec<u32>,
    pub pieces: Vec<Evidence>,
}

impl TileSurface {
    /// Its triangles of the pieces that stay, with the vertices that they use.
    pub fn mesh_of(&self, stays: &[bool]) -> Mesh {
        let triangles: Vec<[u32; 3]> =
            self.mesh.triangles.iter().copied().filter(|t| stays.get(self.piece_of[t[0] as usize] as usize).copied().unwrap_or(false)).collect();
        let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let number = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
        Mesh {
            positions: picked(&self.mesh.positions, &(0..0), &used),
            normals: picked(&self.mesh.normals, &(0..0), &used),
            intensities: picked(&self.mesh.intensities, &(0..0), &used),
            colours: picked(&self.mesh.colours, &(0..0), &used),
            scales: picked(&self.mesh.scales, &(0..0), &used),
            triangles: triangles.into_iter().map(|t| t.map(number)).collect(),
        }
    }

    /// The same at a level of detail, with finest voxels of `voxel` metres. Vertices at the border of the tile stay where they are, so that it fits to its neighbours at any level.
    pub fn coarse_mesh_of(&self, stays: &[bool], voxel: f32, lod: usize) -> Mesh {
        let mut mesh = self.mesh_of(stays);
        if lod > 0 {
            let shared = self.border.iter().map(|(_, v)| *v as usize).chain(self.own()..self.mesh.positions.len());
            let places: HashSet<[u32; 3]> = shared.map(|v| self.mesh.positions[v].map(f32::to_bits)).collect();
            let is_shared: Vec<bool> = mesh.positions.iter().map(|p| places.contains(&p.map(f32::to_bits))).collect();
            simplify(&mut mesh, voxel * (1u32 << lod.min(SCALES - 1)) as f32, &is_shared);
        }
        mesh
    }

    /// Number of own vertices.
    pub fn own(&self) -> usize {
        self.mesh.positions.len() - self.foreign.len()
    }
}

/// The blocks of a field by tiles with edges of 2^`shift` blocks. A tile is named by what the keys of its blocks begin with.
#[derive(Clone, Debug)]
pub(crate) struct TileIndex {
    shift: u32,
    /// Keys and ids of the blocks of each tile, ascending.
    tiles: HashMap<u64, Vec<(u64, u32)>>,
    /// Number of blocks in all tiles.
    blocks: u32,
    margin: i32,
}

impl TileIndex {
    /// No blocks yet.
    pub fn new(shift: u32) -> Self {
        Self { shift, tiles: HashMap::new(), blocks: 0, margin: MARGIN }
    }

    /// Adds the blocks of `field` that are new since the last time.
    pub fn extend(&mut self, field: &TsdfField) {
        let mut grown = HashSet::new();
        for id in self.blocks..field.ids().end {
            let key = field.block(id).key;
            self.tiles.entry(self.tile_of(key)).or_default().push((key, id));
            grown.insert(self.tile_of(key));
        }
        for tile in grown {
            if let Some(blocks) = self.tiles.get_mut(&tile) {
                blocks.sort_unstable();
            }
        }
        self.blocks = field.ids().end;
        self.set_coloured(!field.colours().is_empty());
    }

    /// Says whether there are colours.
    pub fn set_coloured(&mut self, has_colours: bool) {
        self.margin = if has_colours { COLOUR_MARGIN } else { MARGIN };
    }

    /// The tile of block `key`.
    pub fn tile_of(&self, key: u64) -> u64 {
        key >> (3 * self.shift)
    }

    /// The tile at a point, finest voxels; none where no block can be.
    pub fn tile_at(&self, point: [f32; 3]) -> Option<u64> {
        let block = point.map(|c| (c / BLOCK_EDGE as f32).floor());
        let is_near = block.iter().all(|c| c.abs() < MAX_BLOCK_COORD as f32);
        is_near.then(|| self.tile_of(block_key(block.map(|c| c as i32))))
    }

    /// The place of a tile among all, in tiles: one with `x` one higher is the next along x.
    pub fn place(&self, tile: u64) -> [i32; 3] {
        self.origin(tile).map(|c| c.div_euclid(BLOCK_EDGE as i32 * (1 << self.shift)))
    }

    /// The surface in a tile depends on the blocks this far around it.
    pub fn margin(&self) -> i32 {
        self.margin
    }

    /// The lowest corner of a tile, finest voxels.
    pub fn origin(&self, tile: u64) -> [i32; 3] {
        self.corner(tile).map(|c| c * BLOCK_EDGE as i32)
    }

    /// The first block of a tile, by its coordinates.
    pub fn corner(&self, tile: u64) -> [i32; 3] {
        block_coords(tile << (3 * self.shift))
    }

    /// The tiles in Morton order.
    pub fn tiles(&self) -> Vec<u64> {
        let mut tiles: Vec<u64> = self.tiles.keys().copied().collect();
        tiles.sort_unstable();
        tiles
    }

    /// Splits tiles, ascending, into batches that are extracted one after the other, so that the memory for it is bounded.
    pub fn batches<'a>(&self, tiles: &'a [u64]) -> Vec<&'a [u64]> {
        let (mut batches, mut start, mut blocks) = (Vec::new(), 0, 0);
        let most = if budget() > 0 { SMALL_BATCH } else { BATCH };
        for (i, tile) in tiles.iter().enumerate() {
            blocks += self.tiles.get(tile).map_or(0, Vec::len);
            if blocks >= most || i + 1 == tiles.len() {
                batches.push(&tiles[start..=i]);
                (start, blocks) = (i + 1, 0);
            }
        }
        batches
    }

    /// Ids of the blocks of some tiles and of those around that their surfaces depend on, in Morton order.
    fn needed(&self, tiles: &[u64]) -> Vec<u32> {
        let edge = 1 << self.shift;
        let mut needed: Vec<(u64, u32)> = Vec::new();
        for &tile in tiles {
            let low = self.corner(tile);
            let reach = (self.margin + edge - 1) >> self.shift;
            let side = 2 * reach + 1;
            for i in 0..side * side * side {
                let offset = [i % side - reach, i / side % side - reach, i / (side * side) - reach];
                let near = self.tile_of(block_key([0, 1, 2].map(|k| low[k] + edge * offset[k])));
                let Some(blocks) = self.tiles.get(&near) else { continue };
                let is_near = |key: u64| {
                    let c = block_coords(key);
                    (0..3).all(|k| c[k] >= low[k] - self.margin && c[k] < low[k] + edge + self.margin)
                };
                needed.extend(blocks.iter().filter(|(key, _)| near == tile || is_near(*key)));
            }
        }
        needed.sort_unstable();
        needed.dedup();
        needed.into_iter().map(|(_, id)| id).collect()
    }
}

/// The surfaces of some tiles of `field`, ascending, with finest voxels of `voxel` metres, at full detail and with all pieces.
pub(crate) fn tile_surfaces(field: &TsdfField, voxel: f32, options: &MeshOptions, index: &TileIndex, tiles: &[u64]) -> Vec<TileSurface> {
    let resolved = ResolvedBlocks::of(field, index.needed(tiles));
    let mut mesh = Mesh::default();
    let (grid, vertices, parts) = extract_blocks(&mut mesh, &resolved, voxel, options);
    let (mut first, mut starts) = (0, Vec::with_capacity(parts.len()));
    for part in &parts {
        starts.push(first);
        first += part.triangles();
    }
    let batch = Batch { resolved: &resolved, grid: &grid, vertices: &vertices, parts: &parts, starts: &starts, mesh: &mesh, shift: index.shift };
    tiles.par_iter().map(|tile| batch.tile(*tile)).collect()
}

/// What was extracted together.
struct Batch<'a> {
    resolved: &'a ResolvedBlocks<'a>,
    grid: &'a BlockGrid,
    vertices: &'a [BlockVertices],
    parts: &'a [MeshPart],
    /// The first triangle of each part.
    starts: &'a [usize],
    mesh: &'a Mesh,
    shift: u32,
}

impl Batch<'_> {
    fn tile(&self, tile: u64) -> TileSurface {
        let heads = &self.grid.heads;
        let ranks =
            heads.partition_point(|head| head.key >> (3 * self.shift) < tile)..heads.partition_point(|head| head.key >> (3 * self.shift) <= tile);
        let first = |rank: usize| self.vertices.get(rank).map_or(self.mesh.positions.len(), |block| block.first as usize);
        let own = first(ranks.start)..first(ranks.end);
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        for rank in ranks.clone() {
            let part = part_of(rank);
            for range in self.parts[part].of_block(rank - part * PART) {
                triangles.extend_from_slice(&self.mesh.triangles[range.start + self.starts[part]..range.end + self.starts[part]]);
            }
        }
        // Numbers ascend as names do.
        let mut copies: Vec<u32> = triangles.iter().flatten().copied().filter(|v| !own.contains(&(*v as usize))).collect();
        copies.sort_unstable();
        copies.dedup();
        let local = |v: u32| {
            if own.contains(&(v as usize)) { v - own.start as u32 } else { (own.len() + copies.binary_search(&v).unwrap_or(0)) as u32 }
        };
        let triangles: Vec<[u32; 3]> = triangles.into_iter().map(|t| t.map(local)).collect();
        let mesh = Mesh {
            positions: picked(&self.mesh.positions, &own, &copies),
            normals: picked(&self.mesh.normals, &own, &copies),
            intensities: picked(&self.mesh.intensities, &own, &copies),
            colours: picked(&self.mesh.colours, &own, &copies),
            scales: picked(&self.mesh.scales, &own, &copies),
            triangles,
        };
        let (piece_of, pieces) = pieces_of(&mesh, own.len(), self.resolved, &heads[ranks.clone()], &self.vertices[ranks.clone()]);
        TileSurface { foreign: copies.iter().map(|v| self.name(*v)).collect(), border: self.border(tile, ranks), mesh, piece_of, pieces }
    }

    /// The name of vertex `v`.
    fn name(&self, v: u32) -> VertexKey {
        // Blocks without vertices have the number of the next one.
        let rank = self.vertices.partition_point(|block| block.first <= v) - 1;
        let (word, bit) = self.vertices[rank].word_and_bit(v - self.vertices[rank].first);
        VertexKey { block: self.grid.heads[rank].key, word, bit }
    }

    /// Vertices of the blocks `ranks` whose voxels lie at the border of their tile.
    fn border(&self, tile: u64, ranks: Range<usize>) -> Vec<(VertexKey, u32)> {
        let (low, edge) = (block_coords(tile << (3 * self.shift)), 1 << self.shift);
        let mut border = Vec::new();
        let Some(start) = self.vertices.get(ranks.start).map(|block| block.first) else { return border };
        for rank in ranks {
            let (head, block) = (&self.grid.heads[rank], &self.vertices[rank]);
            let (c, n) = (block_coords(head.key), head.edge());
            let is_first = [0, 1, 2].map(|k| c[k] == low[k]);
            let is_last = [0, 1, 2].map(|k| c[k] + 1 == low[k] + edge);
            if is_first.iter().chain(&is_last).all(|is| !is) {
                continue;
            }
            let mut next = block.first - start;
            for (word, &bits) in block.words.iter().enumerate() {
                let mut left = bits;
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let at = coords(mask_index(word, bit));
                    if (0..3).any(|k| is_first[k] && at[k] == 0 || is_last[k] && at[k] + 1 == n) {
                        border.push((VertexKey { block: head.key, word: word as u8, bit: bit as u8 }, next));
                    }
                    next += 1;
                }
            }
        }
        border
    }
}

/// The values of a range of vertices and of some others, if there are any.
fn picked<T: Copy>(values: &[T], range: &Range<usize>, others: &[u32]) -> Vec<T> {
    if values.is_empty() {
        return Vec::new();
    }
    let mut picked = Vec::with_capacity(range.len() + others.len());
    picked.extend_from_slice(&values[range.clone()]);
    picked.extend(others.iter().map(|v| values[*v as usize]));
    picked
}
