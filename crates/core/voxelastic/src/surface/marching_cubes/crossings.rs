//! Finds the edges that the surface crosses, which become vertices, and the cells that become triangles, block by block.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::cells::{Cell, SurfaceCells, owned_seams};
use super::edge_table::{TABLE, WIDE};
use super::mc_table::{CASES, EDGES};
use super::mesh_part::{BlockVertices, CASE_SHIFT, MeshPart, VertexName};
use crate::simd::{Kernel, dispatch};
use crate::surface::blocks::block_grid::{BlockHead, Neighbours, PART};
use crate::surface::blocks::block_masks::valid;
use crate::surface::blocks::fill_holes::FilledField;
use crate::surface::blocks::padding::{LAYER, PaddedBlock};
use rayon::prelude::*;

/// Finds the vertices of each block, and the cells and triangles of each part.
pub(crate) fn find(filled: &FilledField<'_>) -> (Vec<BlockVertices>, Vec<MeshPart>) {
    let mut vertices: Vec<BlockVertices> = bytemuck::allocation::zeroed_vec(filled.blocks.len());
    let parts = vertices.par_chunks_mut(PART).enumerate().map(|(i, vertices)| {
        let mut part = MeshPart::default();
        dispatch(FindCrossings { filled, first: i * PART, vertices, part: &mut part });
        part
    });
    let parts: Vec<MeshPart> = parts.collect();
    for name in parts.iter().flat_map(|part| &part.seams).flatten() {
        vertices[name.rank as usize].words[usize::from(name.word)] |= 1 << name.bit;
    }
    vertices.par_chunks_mut(PART).for_each(|vertices| dispatch(CountVertices { vertices }));
    let mut first = 0;
    for block in &mut vertices {
        block.first = first;
        first += block.count();
    }
    (vertices, parts)
}

/// Numbers the vertices within blocks.
struct CountVertices<'a> {
    vertices: &'a mut [BlockVertices],
}

impl Kernel for CountVertices<'_> {
    #[inline(always)]
    fn run(self) {
        for i in 0..self.vertices.len() {
            self.vertices[i].number_words();
        }
    }
}

/// Finds the cells of a part's blocks.
struct FindCrossings<'a> {
    filled: &'a FilledField<'a>,
    /// Rank of the first block.
    first: usize,
    vertices: &'a mut [BlockVertices],
    part: &'a mut MeshPart,
}

impl Kernel for FindCrossings<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { filled, first, vertices, part } = self;
        let triangles = &TABLE.counts;
        for i in 0..vertices.len() {
            let (neighbours, head) = (&filled.grid.neighbours[first + i], &filled.grid.heads[first + i]);
            let n = head.edge();
            let padded = PaddedBlock::native(neighbours, n, filled);
            if let Some(cells) = SurfaceCells::find(&padded, filled, neighbours, head) {
                use_edges(&mut vertices[i], &cells, n);
                add_cells(part, &cells, n, triangles);
            }
            part.ends.push(part.cells.len() as u32);
            part.triangle_ends.push(part.cell_triangles as u32);
            if neighbours.coarser != 0
                && let Some(seams) = owned_seams(neighbours, n)
                && let Some(mut cells) = SurfaceCells::find(&padded.with_coarser(), filled, neighbours, head)
            {
                for i in 0..seams.len() {
                    cells.rows[i] &= seams[i];
                }
                add_seams(part, &cells, filled, neighbours, head);
            }
            part.seam_ends.push(part.seams.len() as u32);
        }
    }
}

/// Marks the edges that are crossed and adjacent to a cell.
#[inline(always)]
fn use_edges(vertices: &mut BlockVertices, SurfaceCells { rows: cells, behind }: &SurfaceCells, n: usize) {
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

/// Adds the cells above the block's lower faces; those on the faces belong to the blocks before.
#[inline(always)]
fn add_cells(part: &mut MeshPart, cells: &SurfaceCells, n: usize, triangles: &[u8; 256]) {
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
            part.cells.push((x + WIDE * (y + WIDE * z)) as u32 | (case as u32) << CASE_SHIFT);
            part.cell_triangles += usize::from(triangles[case]);
        }
    }
}

/// Adds the triangles of cells where scales meet.
fn add_seams(part: &mut MeshPart, cells: &SurfaceCells, filled: &FilledField<'_>, neighbours: &Neighbours, head: &BlockHead) {
    for i in 0..WIDE * LAYER {
        let mut left = cells.rows[i];
        while left != 0 {
            let x = left.trailing_zeros() as i32;
            left &= left - 1;
            let cell = Cell::at([x, (i % LAYER) as i32, (i / LAYER) as i32], filled, neighbours, head);
            let case = cell.corners.iter().rev().fold(0, |case, corner| case << 1 | usize::from(corner.distance < 0.0));
            for &triangle in &CASES[case] {
                let [p, q, r] = triangle.map(|edge| name(&cell, usize::from(edge)));
                // Corners of such a cell may be one and the same voxel.
                if p != q && q != r && r != p {
                    part.seams.push([p, q, r]);
                }
            }
        }
    }
}

/// The vertex on an edge of a cell.
fn name(cell: &Cell, edge: usize) -> VertexName {
    let ([from, to], axis) = (EDGES[edge].map(|i| &cell.corners[i]), edge / 4);
    if to.scale < from.scale { VertexName::new(to.rank, to.mask_index, axis + 3) } else { VertexName::new(from.rank, from.mask_index, axis) }
}
