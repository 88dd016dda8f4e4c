//! Pieces of a surface that have too little evidence are left out.
//!
//! Returns from dust, from leaves and from the edges of things, scans that are a little off and things that moved leave small components: pieces of a few triangles that few rays
//! saw. A piece's evidence is the sum of the observations at its vertices, so that one that is large, or was seen often, stays. Measurements of a
//! surface that is there agree on its direction, and those of a small component do not: a flat piece needs much less evidence. Normals of a pole, a rail or a cable have all
//! directions across its axis and none along it: such a piece needs less, too.
//!
//! All sums are of whole numbers, so that a piece that lies in several tiles has the same evidence however it is divided.

use super::blocks::block_grid::BlockHead;
use super::blocks::block_masks::coords;
use super::blocks::resolved_blocks::ResolvedBlocks;
use super::marching_cubes::mesh_part::BlockVertices;
use super::marching_cubes::vertices::mask_index;
use super::mesh::Mesh;
use super::pieces::Pieces;
use crate::field::tsdf::{Voxel, WEIGHT_ONE};
use crate::octree::{voxel_index, voxels_at};
use nalgebra::Matrix3;

/// Least evidence of a piece that stays: observations, summed over its vertices.
const LEAST_EVIDENCE: u32 = 120;
/// The same for a flat piece ...
const LEAST_OF_FLAT: u32 = 12;
/// ... whose mean normal is at least this long.
const FLAT: f64 = 0.95;
/// The same for a piece whose normals are across one axis ...
const LEAST_OF_BAR: u32 = 40;
/// ... which is if the mean square of their components along it is at most this.
const ACROSS: f64 = 0.05;
/// A vertex counts as this many observations at most, so that a piece of a few triangles is a small component however often it was seen.
const MOST_OF_ONE: u16 = 8;
/// Steps of the components of normals, and of areas in square metres.
const NORMAL_STEPS: f32 = 4096.0;
const AREA_STEPS: f64 = 1e9;

/// What was left out of a surface for lack of evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SmallComponents {
    /// Connected pieces.
    pub pieces: u64,
    /// Triangles of these pieces.
    pub triangles: u64,
    /// Their area, square metres.
    pub area: f64,
}

impl SmallComponents {
    /// Adds a piece.
    pub(super) fn add(&mut self, piece: &Evidence) {
        self.pieces += 1;
        self.triangles += u64::from(piece.triangles);
        self.area += piece.area as f64 / AREA_STEPS;
    }
}

/// What speaks for a piece of a surface, or for a part of one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Evidence {
    vertices: u32,
    triangles: u32,
    /// Observations at its vertices, by [`WEIGHT_ONE`]; not known for a part that is enough by itself.
    observations: u32,
    /// Sum of the normals at its vertices, in steps.
    normals: [i64; 3],
    /// Sums of the products of their components, in squared steps: xx, xy, xz, yy, yz, zz.
    products: [i64; 6],
    /// In steps.
    area: u64,
}

impl Evidence {
    /// Adds another part of the same piece.
    pub fn add(&mut self, other: &Self) {
        self.vertices += other.vertices;
        self.triangles += other.triangles;
        self.observations = self.observations.saturating_add(other.observations);
        self.area += other.area;
        (0..3).for_each(|k| self.normals[k] += other.normals[k]);
        (0..6).for_each(|k| self.products[k] += other.products[k]);
    }

    /// Adds the normal at a vertex.
    fn add_vertex(&mut self, normal: [f32; 3]) {
        let [x, y, z] = normal.map(|c| (c * NORMAL_STEPS) as i64);
        self.vertices += 1;
        self.normals = [self.normals[0] + x, self.normals[1] + y, self.normals[2] + z];
        let products = [x * x, x * y, x * z, y * y, y * z, z * z];
        (0..6).for_each(|k| self.products[k] += products[k]);
    }

    /// Whether it is enough for the piece to stay.
    pub fn is_enough(&self) -> bool {
        let is_seen = |times: u32| self.observations >= times * u32::from(WEIGHT_ONE);
        self.vertices >= LEAST_EVIDENCE
            || is_seen(LEAST_EVIDENCE)
            || is_seen(LEAST_OF_FLAT) && self.is_flat()
            || is_seen(LEAST_OF_BAR) && self.is_across_an_axis()
    }

    /// Whether its normals have one direction.
    fn is_flat(&self) -> bool {
        let least = FLAT * f64::from(self.vertices) * f64::from(NORMAL_STEPS);
        self.normals.iter().map(|c| (*c as f64).powi(2)).sum::<f64>() >= least * least
    }

    /// Whether there is an axis that its normals are all across.
    fn is_across_an_axis(&self) -> bool {
        let [xx, xy, xz, yy, yz, zz] = self.products.map(|sum| sum as f64);
        let products = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        products.symmetric_eigenvalues().min() <= ACROSS * products.trace()
    }
}

/// The piece of each vertex of a tile's mesh, and what the tile has of the evidence of each: its first `own` vertices, which are those of `blocks`, and its triangles.
pub(super) fn pieces_of(
    mesh: &Mesh,
    own: usize,
    resolved: &ResolvedBlocks<'_>,
    heads: &[BlockHead],
    blocks: &[BlockVertices],
) -> (Vec<u32>, Vec<Evidence>) {
    let count = mesh.positions.len();
    let pieces = Pieces::new(&mesh.triangles, 0, count);
    let (mut piece_of, mut evidence) = (vec![0; count], Vec::new());
    for v in 0..count {
        let lowest = pieces.lowest(v);
        if lowest == v {
            piece_of[v] = evidence.len() as u32;
            evidence.push(Evidence::default());
        }
        piece_of[v] = piece_of[lowest];
        if v < own {
            evidence[piece_of[v] as usize].add_vertex(mesh.normals[v]);
        }
    }
    for t in &mesh.triangles {
        let piece = &mut evidence[piece_of[t[0] as usize] as usize];
        piece.triangles += 1;
        piece.area += (area(t.map(|v| mesh.positions[v as usize])) * AREA_STEPS).round() as u64;
    }
    let is_small: Vec<bool> = evidence.iter().map(|piece| piece.vertices < LEAST_EVIDENCE).collect();
    for (v, weight) in weights(resolved, heads, blocks, |v| is_small[piece_of[v] as usize]) {
        evidence[piece_of[v as usize] as usize].observations += u32::from(weight.min(MOST_OF_ONE * WEIGHT_ONE));
    }
    (piece_of, evidence)
}

/// Of the vertices of some blocks, numbered from zero on, those that are `wanted`, and the weight of the less observed one of the two voxels between which each
/// lies; of a pair with a filled voxel, or of two blocks, that of the vertex' own one.
fn weights(resolved: &ResolvedBlocks<'_>, heads: &[BlockHead], blocks: &[BlockVertices], wanted: impl Fn(usize) -> bool) -> Vec<(u32, u16)> {
    let (mut weights, mut voxels) = (Vec::new(), [Voxel::default(); voxels_at(0)]);
    let Some(start) = blocks.first().map(|block| block.first) else { return weights };
    for (block, head) in blocks.iter().zip(heads) {
        let first = block.first - start;
        if !(first..first + block.count()).any(|v| wanted(v as usize)) {
            continue;
        }
        resolved.copy(head.id, &mut voxels);
        let weight = |c: [usize; 3]| voxels[voxel_index(c, head.scale.into()) % voxels_at(0)].weight;
        let mut next = first;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A piece of `vertices` vertices that were observed once each, with the normals that `normal` gives.
    fn piece(vertices: usize, normal: impl Fn(usize) -> [f32; 3]) -> Evidence {
        let mut piece = Evidence { observations: vertices as u32 * u32::from(WEIGHT_ONE), ..Evidence::default() };
        (0..vertices).for_each(|i| piece.add_vertex(normal(i)));
        piece
    }

    /// A direction around the axis `(0.6, 0, 0.8)`, and a share of it.
    fn around(angle: f32, along: f32) -> [f32; 3] {
        let (sine, cosine, across) = (angle.sin(), angle.cos(), (1.0 - along * along).sqrt());
        [0.6 * along + across * 0.8 * cosine, across * sine, 0.8 * along - across * 0.6 * cosine]
    }

    #[test]
    fn flat_pieces_and_bars_need_less_evidence_than_others() {
        let flat = |vertices| piece(vertices, |i| around(i as f32, if i % 2 == 0 { 0.99 } else { 0.97 })).is_enough();
        let bar = |vertices| piece(vertices, |i| around(i as f32, 0.3 * (i as f32).sin())).is_enough();
        let any = |vertices| piece(vertices, |i| around(2.4 * i as f32, 1.0 - 2.0 * (i as f32 + 0.5) / vertices as f32)).is_enough();
        assert_eq!([11, 12].map(flat), [false, true]);
        assert_eq!([39, 40].map(bar), [false, true]);
        assert_eq!([119, 120].map(any), [false, true]);
        // Half a piece is not judged: its parts add up.
        let (mut one, other) = (piece(20, |i| around(i as f32, 0.0)), piece(20, |i| around(i as f32 + 0.5, 0.0)));
        assert!(!one.is_enough() && !other.is_enough());
        one.add(&other);
        assert!(one.is_enough());
    }
}
