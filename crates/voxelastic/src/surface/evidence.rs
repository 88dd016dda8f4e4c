//! Pieces of a surface that have too little evidence are left out.
//!
//! Returns from dust, from leaves and from the edges of things, scans that are a little off and things that moved leave crumbs: pieces of a few triangles that few rays
//! saw. A piece's evidence is the sum of the observations at its vertices, so that one that is large, or was seen often, stays. Measurements of a
//! surface that is there agree on its direction, and those of a crumb do not: a flat piece needs much less evidence.

use super::block_grid::{BlockGrid, PART};
use super::block_masks::coords;
use super::mesh::Mesh;
use super::mesh_part::BlockVertices;
use super::pieces::Pieces;
use super::resolved_blocks::ResolvedBlocks;
use super::vertices::mask_index;
use crate::field::tsdf::{Voxel, WEIGHT_ONE};
use crate::octree::{voxel_index, voxels_at};
use rayon::prelude::*;

/// Least evidence of a piece that stays: observations, summed over its vertices.
const LEAST_EVIDENCE: u32 = 120;
/// The same for a flat piece ...
const LEAST_OF_FLAT: u32 = 12;
/// ... whose mean normal is at least this long.
const FLAT: f32 = 0.95;
/// A vertex counts as this many observations at most, so that a piece of a few triangles is a crumb however often it was seen.
const MOST_OF_ONE: u16 = 8;

/// What was left out of a surface for lack of evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Crumbs {
    /// Connected pieces.
    pub pieces: u64,
    /// Triangles of these pieces.
    pub triangles: u64,
    /// Their area, square metres.
    pub area: f64,
}

/// Removes the pieces with too little evidence from the end of `mesh`, from the `first` vertex and triangle on, whose vertices are those of `blocks`.
pub(super) fn remove_crumbs(mesh: &mut Mesh, first: [usize; 2], resolved: &ResolvedBlocks<'_>, grid: &BlockGrid, blocks: &[BlockVertices]) -> Crumbs {
    let pieces = Pieces::new(&mesh.triangles[first[1]..], first[0] as u32, mesh.positions.len() - first[0]);
    let is_small = |v: usize| pieces.vertices(v) < LEAST_EVIDENCE;
    let mut evidence = vec![0u32; mesh.positions.len() - first[0]];
    for (v, weight) in weights(resolved, grid, blocks, is_small).into_iter().flatten() {
        evidence[pieces.lowest(v as usize)] += u32::from(weight.min(MOST_OF_ONE * WEIGHT_ONE));
    }
    let mut normals = vec![[0f32; 3]; evidence.len()];
    for (v, n) in mesh.normals[first[0]..].iter().enumerate().filter(|(v, _)| is_small(*v)) {
        let sum = &mut normals[pieces.lowest(v)];
        *sum = std::array::from_fn(|k| sum[k] + n[k]);
    }
    let least = |v: usize| {
        let flat = FLAT * pieces.vertices(v) as f32;
        if normals[pieces.lowest(v)].iter().map(|c| c * c).sum::<f32>() < flat * flat { LEAST_EVIDENCE } else { LEAST_OF_FLAT }
    };
    let stays = |v: usize| !is_small(v) || evidence[pieces.lowest(v)] >= least(v) * u32::from(WEIGHT_ONE);
    let mut crumbs = Crumbs { pieces: (0..evidence.len()).filter(|&v| pieces.lowest(v) == v && !stays(v)).count() as u64, ..Crumbs::default() };
    if crumbs.pieces > 0 {
        for t in mesh.triangles[first[1]..].iter().filter(|t| !stays(t[0] as usize - first[0])) {
            crumbs.triangles += 1;
            crumbs.area += area(t.map(|v| mesh.positions[v as usize]));
        }
        mesh.retain_from(first, stays);
    }
    crumbs
}

/// For each part of the blocks, the vertices that are `wanted`, and the weight of the less observed one of the two voxels between which each lies; of a
/// pair with a filled voxel, or of two blocks, that of the vertex' own one.
fn weights(resolved: &ResolvedBlocks<'_>, grid: &BlockGrid, blocks: &[BlockVertices], wanted: impl Fn(usize) -> bool + Sync) -> Vec<Vec<(u32, u16)>> {
    let parts = blocks.par_chunks(PART).zip(grid.heads.par_chunks(PART));
    let weights = parts.map(|(blocks, heads)| {
        let (mut weights, mut voxels) = (Vec::new(), [Voxel::default(); voxels_at(0)]);
        for (block, head) in blocks.iter().zip(heads) {
            if !(block.first..block.first + block.count()).any(|v| wanted(v as usize)) {
                continue;
            }
            resolved.copy(head.id, &mut voxels);
            let weight = |c: [usize; 3]| voxels[voxel_index(c, head.scale.into()) % voxels_at(0)].weight;
            let mut next = block.first;
            for (word, &bits) in block.words.iter().enumerate() {
                let mut left = bits;
                while left != 0 {
                    let here = coords(mask_index(word, left.trailing_zeros() as usize));
                    left &= left - 1;
                    if wanted(next as usize) {
                        let mut there = here;
                        if word < 24 && here[word / 8] + 1 < head.edge() {
                            there[word / 8] += 1;
                        }
                        weights.push((next, less_known(weight(here), weight(there))));
                    }
                    next += 1;
                }
            }
        }
        weights
    });
    weights.collect()
}

/// The smaller of two weights, ignoring one that is zero.
fn less_known(a: u16, b: u16) -> u16 {
    if a.min(b) == 0 { a.max(b) } else { a.min(b) }
}

/// Area of a triangle.
fn area([a, b, c]: [[f32; 3]; 3]) -> f64 {
    let side = |p: [f32; 3]| nalgebra::Vector3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(p[k]) - f64::from(a[k])));
    0.5 * side(b).cross(&side(c)).norm()
}
