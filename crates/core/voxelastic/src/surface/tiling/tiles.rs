//! The surface in tiles: cubes of blocks that can be extracted one by one, so that a part of a surface costs what its blocks cost.

use crate::field::tsdf::TsdfField;
use crate::octree::{BLOCK_EDGE, block_coords};
use crate::surface::blocks::resolved_blocks::ResolvedBlocks;
use crate::surface::extract::{MeshOptions, extract_blocks};
use crate::surface::mesh::Mesh;
use crate::surface::simplify::coarsen;
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;

/// Edge of a tile in blocks: 64 finest voxels.
pub const TILE_EDGE: i32 = 8;
/// The mesh of a block depends on the blocks this far around it: its vertices lie between voxels of neighbouring blocks, whose holes are filled from
/// their neighbours, and normals are means over the triangles around a vertex.
const MARGIN: i32 = 2;

/// A tile by its position in the submap frame, in tiles: tile `[x, y, z]` begins at that many times [`TILE_EDGE`] blocks.
pub type Tile = [i32; 3];

/// Extracts the surface in some tiles, each in metres of the submap frame, with finest voxels of `voxel` metres. A triangle belongs to the tile that
/// contains its centre, so that the tiles of a field together are [`extract`](crate::surface::extract()), but for the order of triangles and the last bits of
/// normals. Nothing is left out for want of evidence: where a piece is cut by a tile, its extent is unknown. Tiles without a surface are returned as empty meshes, in the order of `tiles`.
pub fn extract_tiles(field: &TsdfField, voxel: f32, options: &MeshOptions, tiles: &[Tile]) -> Vec<Mesh> {
    let wanted: HashMap<Tile, usize> = tiles.iter().enumerate().map(|(i, tile)| (*tile, i)).collect();
    let near: HashSet<Tile> = tiles.iter().flat_map(|t| tiles_around(t.map(|c| c * TILE_EDGE + TILE_EDGE / 2), TILE_EDGE)).collect();
    let is_needed = |id: &u32| {
        let block = block_coords(field.block(*id).key);
        near.contains(&tile_of(block)) && tiles_around(block, MARGIN).any(|tile| wanted.contains_key(&tile))
    };
    let mut ids: Vec<u32> = field.ids().into_par_iter().with_min_len(4096).filter(is_needed).collect();
    ids.par_sort_unstable_by_key(|id| field.block(*id).key);
    let mut mesh = Mesh::default();
    extract_blocks(&mut mesh, &ResolvedBlocks::of(field, ids), voxel, options);
    coarsen(&mut mesh, [0; 2], voxel, options.lod);
    split(&mesh, voxel, &wanted)
}

fn tile_of(block: [i32; 3]) -> Tile {
    block.map(|c| c.div_euclid(TILE_EDGE))
}

/// The tiles of the blocks within `reach` blocks of a block, for a reach of at most [`TILE_EDGE`].
fn tiles_around(block: [i32; 3], reach: i32) -> impl Iterator<Item = Tile> {
    let (low, high) = (tile_of(block.map(|c| c - reach)), tile_of(block.map(|c| c + reach)));
    let axis = move |k: usize| low[k]..=high[k];
    axis(2).flat_map(move |z| axis(1).flat_map(move |y| axis(0).map(move |x| [x, y, z])))
}

/// The triangles of each wanted tile with the vertices that they use.
fn split(mesh: &Mesh, voxel: f32, wanted: &HashMap<Tile, usize>) -> Vec<Mesh> {
    let edge = voxel * (TILE_EDGE * BLOCK_EDGE as i32) as f32;
    let tile = |t: &[u32; 3]| {
        let corners = t.map(|v| mesh.positions[v as usize]);
        let centre: Tile = std::array::from_fn(|k| ((corners[0][k] + corners[1][k] + corners[2][k]) / (3.0 * edge)).floor() as i32);
        wanted.get(&centre).map(|&i| i as u32)
    };
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); wanted.len()];
    let of_triangles: Vec<Option<u32>> = mesh.triangles.par_iter().with_min_len(4096).map(tile).collect();
    for (triangle, tile) in of_triangles.into_iter().enumerate() {
        if let Some(tile) = tile {
            members[tile as usize].push(triangle as u32);
        }
    }
    members.par_iter().map(|triangles| part(mesh, triangles)).collect()
}

/// Some triangles of a mesh as a mesh, vertices in the order of their use.
fn part(mesh: &Mesh, triangles: &[u32]) -> Mesh {
    let mut numbers: HashMap<u32, u32> = HashMap::with_capacity(triangles.len());
    let mut vertices: Vec<u32> = Vec::with_capacity(triangles.len());
    let number = |v: u32| {
        *numbers.entry(v).or_insert_with(|| {
            vertices.push(v);
            vertices.len() as u32 - 1
        })
    };
    let triangles = triangles.iter().map(|t| mesh.triangles[*t as usize]).collect::<Vec<_>>();
    let triangles = triangles.into_iter().flatten().map(number).collect::<Vec<u32>>().chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    Mesh {
        positions: picked(&mesh.positions, &vertices),
        normals: picked(&mesh.normals, &vertices),
        intensities: picked(&mesh.intensities, &vertices),
        colours: picked(&mesh.colours, &vertices),
        scales: picked(&mesh.scales, &vertices),
        triangles,
    }
}

/// The values of some vertices, if there are any.
fn picked<T: Copy>(values: &[T], vertices: &[u32]) -> Vec<T> {
    if values.is_empty() { Vec::new() } else { vertices.iter().map(|v| values[*v as usize]).collect() }
}
