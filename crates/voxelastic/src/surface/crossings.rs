//! From cells to what they need: the edges that become vertices, and the cells that become triangles, block by block.
//!
//! A vertex lies on a dual edge, between two voxels that share a face. The finer of the two owns it (the lower one among
//! equals), so (block, direction, place) names it. A block's names, a bit each, number its vertices.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::cases::{CASES, EDGES};
use super::cells::{Cell, Cells, owned_seams};
use super::gaps::Closed;
use super::layout::{Around, Head, PART};
use super::rows::{LAYER, Padded};
use super::samples::valid;
use super::triangles::TABLE;
use crate::dispatch::{Kernel, dispatch};
use crate::geometry::bits::rank;
use bytemuck::Zeroable;
use rayon::prelude::*;

/// The vertices of a block: bits of the lower voxel for those between it and the next one along x, y and z, layer by layer; bits of the two other
/// coordinates for those between a voxel on the block's lower faces and a larger one before it.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct Vertices {
    pub words: [u64; 27],
    /// How many there are before those of each word.
    pub before: [u16; 27],
    /// Number of the first one.
    pub first: u32,
}

impl Vertices {
    /// The number of a vertex by word and bit.
    #[inline(always)]
    pub fn number(&self, word: usize, bit: usize) -> u32 {
        self.first + u32::from(self.before[word]) + rank(self.words[word], bit) as u32
    }

    /// How many there are.
    #[inline(always)]
    pub fn count(&self) -> u32 {
        u32::from(self.before[26]) + self.words[26].count_ones()
    }

    /// Counts those before each word.
    #[inline(always)]
    fn number_words(&mut self) {
        let mut count = 0;
        for i in 0..27 {
            self.before[i] = count;
            count += self.words[i].count_ones() as u16;
        }
    }
}

/// A vertex by name.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Name {
    pub rank: u32,
    pub word: u8,
    pub bit: u8,
}

impl Name {
    /// The vertex of the voxel at `place` in block `rank` towards direction 0..3, +x +y +z, or 3..6, -x -y -z.
    fn new(rank: u32, place: u16, direction: usize) -> Self {
        let (layer, bit) = ((place >> 6) as usize, place & 63);
        if direction < 3 {
            return Self { rank, word: (8 * direction + layer) as u8, bit: bit as u8 };
        }
        let bit = match direction {
            3 => bit >> 3 | (layer as u16) << 3,
            4 => bit & 7 | (layer as u16) << 3,
            _ => bit,
        };
        Self { rank, word: (21 + direction) as u8, bit: bit as u8 }
    }
}

/// The part of a mesh that some blocks own, before vertices have numbers.
#[derive(Default)]
pub(super) struct Part {
    /// Cells with all corners in blocks of one scale: cell below, case above [`CASE_SHIFT`].
    pub cells: Vec<u32>,
    /// Where each block's cells end.
    pub ends: Vec<u32>,
    /// How many triangles they have.
    pub cell_triangles: usize,
    /// Triangles where scales meet.
    pub seams: Vec<[Name; 3]>,
}

impl Part {
    /// How many triangles it has.
    pub fn triangles(&self) -> usize {
        self.cell_triangles + self.seams.len()
    }
}

/// Where the case of a cell begins; below is the voxel at its lower corner, as an index into 9 x 9 x 9.
pub(super) const CASE_SHIFT: u32 = 16;
/// Voxels along an edge of a block and of the first of those beyond.
pub(super) const WIDE: usize = 9;

/// Finds what every block contributes.
pub(super) fn find(closed: &Closed<'_>) -> (Vec<Vertices>, Vec<Part>) {
    let mut vertices: Vec<Vertices> = bytemuck::allocation::zeroed_vec(closed.blocks.len());
    let parts = vertices.par_chunks_mut(PART).enumerate().map(|(i, vertices)| {
        let mut part = Part::default();
        dispatch(Find { closed, first: i * PART, vertices, part: &mut part });
        part
    });
    let parts: Vec<Part> = parts.collect();
    for name in parts.iter().flat_map(|part| &part.seams).flatten() {
        vertices[name.rank as usize].words[usize::from(name.word)] |= 1 << name.bit;
    }
    vertices.par_chunks_mut(PART).for_each(|vertices| dispatch(Number { vertices }));
    let mut first = 0;
    for block in &mut vertices {
        block.first = first;
        first += block.count();
    }
    (vertices, parts)
}

/// Counts vertices.
struct Number<'a> {
    vertices: &'a mut [Vertices],
}

impl Kernel for Number<'_> {
    #[inline(always)]
    fn run(self) {
        for i in 0..self.vertices.len() {
            self.vertices[i].number_words();
        }
    }
}

/// Finds the cells of a part's blocks.
struct Find<'a> {
    closed: &'a Closed<'a>,
    /// Rank of the first block.
    first: usize,
    vertices: &'a mut [Vertices],
    part: &'a mut Part,
}

impl Kernel for Find<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { closed, first, vertices, part } = self;
        let triangles = &TABLE.counts;
        for i in 0..vertices.len() {
            let (around, head) = (&closed.layout.around[first + i], &closed.layout.heads[first + i]);
            let n = head.edge();
            let padded = Padded::native(around, n, closed);
            if let Some(cells) = Cells::find(&padded, closed, around, head) {
                use_edges(&mut vertices[i], &cells, n);
                part.add_cells(&cells, n, triangles);
            }
            part.ends.push(part.cells.len() as u32);
            if around.coarser != 0 {
                let Some(seams) = owned_seams(around, n) else { continue };
                let Some(mut cells) = Cells::find(&padded.with_coarser(), closed, around, head) else { continue };
                for i in 0..seams.len() {
                    cells.rows[i] &= seams[i];
                }
                part.add_seams(&cells, closed, around, head);
            }
        }
    }
}

/// Notes the edges that are crossed and have a cell beside them.
#[inline(always)]
fn use_edges(vertices: &mut Vertices, Cells { rows: cells, behind }: &Cells, n: usize) {
    let valid = valid(n);
    for z in 0..n {
        let mut rows = [[0u8; 8]; 3];
        for y in 0..8 {
            let i = y + LAYER * z;
            // The cells to the four sides of an edge along x, bit x + 1 for that from the voxel at x; two by two for the other axes.
            let [low, right, up, far] = [cells[i], cells[i + 1], cells[i + LAYER], cells[i + LAYER + 1]];
            let here = behind[i + LAYER + 1] >> 1;
            rows[0][y] = ((low | right | up | far) >> 1 & (here ^ here >> 1)) as u8;
            rows[1][y] = ((right | far | (right | far) >> 1) & (here ^ behind[i + LAYER + 2] >> 1)) as u8;
            rows[2][y] = ((up | far | (up | far) >> 1) & (here ^ behind[i + 2 * LAYER + 1] >> 1)) as u8;
        }
        for axis in 0..3 {
            vertices.words[8 * axis + z] = u64::from_le_bytes(rows[axis]) & valid;
        }
    }
}

impl Part {
    /// Adds the cells above the block's lower faces; those on the faces belong to the blocks before.
    #[inline(always)]
    fn add_cells(&mut self, cells: &Cells, n: usize, triangles: &[u8; 256]) {
        for z in 0..n {
            let mut rows = [0u8; 8];
            for y in 0..8 {
                rows[y] = (cells.rows[y + 1 + LAYER * (z + 1)] >> 1) as u8;
            }
            let mut left = u64::from_le_bytes(rows);
            while left != 0 {
                let bit = left.trailing_zeros() as usize;
                left &= left - 1;
                let (x, y) = (bit & 7, bit >> 3);
                let i = y + 1 + LAYER * (z + 1);
                let case = cells.case(i, x + 1);
                self.cells.push((x + WIDE * (y + WIDE * z)) as u32 | (case as u32) << CASE_SHIFT);
                self.cell_triangles += usize::from(triangles[case]);
            }
        }
    }

    /// Adds the triangles of cells where scales meet.
    fn add_seams(&mut self, cells: &Cells, closed: &Closed<'_>, around: &Around, head: &Head) {
        for i in 0..WIDE * LAYER {
            let mut left = cells.rows[i];
            while left != 0 {
                let x = left.trailing_zeros() as i32;
                left &= left - 1;
                let cell = Cell::at([x, (i % LAYER) as i32, (i / LAYER) as i32], closed, around, head);
                let case = cell.corners.iter().rev().fold(0, |case, corner| case << 1 | usize::from(corner.distance < 0.0));
                for &triangle in &CASES[case] {
                    let [p, q, r] = triangle.map(|edge| name(&cell, usize::from(edge)));
                    // Corners of such a cell may be one and the same voxel.
                    if p != q && q != r && r != p {
                        self.seams.push([p, q, r]);
                    }
                }
            }
        }
    }
}

/// Name of the vertex on an edge of a cell.
fn name(cell: &Cell, edge: usize) -> Name {
    let ([from, to], axis) = (EDGES[edge].map(|i| &cell.corners[i]), edge / 4);
    if to.scale < from.scale { Name::new(to.rank, to.place, axis + 3) } else { Name::new(from.rank, from.place, axis) }
}
