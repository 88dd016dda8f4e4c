//! Triangles and normals: cells look their vertices up in a table of the block and of the first voxels beyond.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::edge_table::{AXIS, TABLE, WIDE};
use super::mesh_part::{BlockVertices, CASE_SHIFT, MeshPart};
use crate::simd::Kernel;
use crate::surface::blocks::block_grid::{BlockGrid, CENTRE, Neighbours};

/// Writes the triangles of a part's blocks and sums the normals of its vertices.
pub(crate) struct Connect<'a> {
    pub grid: &'a BlockGrid,
    pub vertices: &'a [BlockVertices],
    /// Rank of the first block.
    pub first: usize,
    pub part: &'a MeshPart,
    /// Of all vertices.
    pub positions: &'a [[f32; 3]],
    pub triangles: &'a mut [[u32; 3]],
    /// Added to all numbers in `triangles`.
    pub offset: u32,
    /// Of the part's own vertices, and the number of the first one of them.
    pub normals: &'a mut [NormalSum],
    pub first_normal: u32,
    /// Normals for vertices of other parts.
    pub foreign: &'a mut Vec<(u32, NormalSum)>,
    /// Steps of [`NormalSum`] per square metre.
    pub steps: f32,
}

impl Kernel for Connect<'_> {
    #[inline(always)]
    fn run(mut self) {
        let table = &*TABLE;
        let mut numbers = [0; 3 * AXIS];
        let (mut start, mut next) = (0, 0);
        for (i, &end) in self.part.ends.iter().enumerate() {
            let cells = &self.part.cells[start..end as usize];
            start = end as usize;
            if cells.is_empty() {
                continue;
            }
            let rank = self.first + i;
            let n = self.grid.heads[rank].edge();
            number(&mut numbers, &self.vertices[rank]);
            number_beyond(&mut numbers, &self.grid.neighbours[rank], self.vertices, n);
            for cell in cells {
                let (below, case) = ((cell & ((1 << CASE_SHIFT) - 1)) as usize, (cell >> CASE_SHIFT) as usize);
                let first = usize::from(table.starts[case]);
                for corners in &table.corners[first..first + usize::from(table.counts[case])] {
                    let [p, q, r] = *corners;
                    let triangle = [numbers[below + usize::from(p)], numbers[below + usize::from(q)], numbers[below + usize::from(r)]];
                    self.add(next, triangle);
                    next += 1;
                }
            }
        }
        for names in &self.part.seams {
            let mut triangle = [0; 3];
            for k in 0..3 {
                triangle[k] = self.vertices[names[k].rank as usize].number(names[k].word.into(), names[k].bit.into());
            }
            self.add(next, triangle);
            next += 1;
        }
    }
}

impl Connect<'_> {
    #[inline(always)]
    fn add(&mut self, index: usize, triangle: [u32; 3]) {
        let [a, b, c] = [self.positions[triangle[0] as usize], self.positions[triangle[1] as usize], self.positions[triangle[2] as usize]];
        let n = area_normal(a, b, c).map(|v| (v * self.steps) as i32);
        for vertex in triangle {
            let own = vertex.wrapping_sub(self.first_normal) as usize;
            if own < self.normals.len() {
                let normal = &mut self.normals[own];
                *normal = added(*normal, n);
            } else {
                self.foreign.push((vertex, n));
            }
        }
        self.triangles[index] = [triangle[0] + self.offset, triangle[1] + self.offset, triangle[2] + self.offset];
    }
}

/// Sum of the normals of triangles, as long as twice their areas: whole steps, so that the order of summation does not matter.
pub(crate) type NormalSum = [i32; 3];

/// Steps of [`NormalSum`] per square of a finest voxel's edge: triangles of the coarsest voxels are 200 times as large.
pub(crate) const NORMAL_STEPS: f32 = (1 << 18) as f32;

/// The sum of two.
#[inline(always)]
pub(crate) fn added(a: NormalSum, b: NormalSum) -> NormalSum {
    [a[0].wrapping_add(b[0]), a[1].wrapping_add(b[1]), a[2].wrapping_add(b[2])]
}

/// Normal of a triangle, as long as twice its area.
#[inline(always)]
fn area_normal(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> [f32; 3] {
    let u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    let v = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// Index of a vertex in the table by axis, layer, and bit in the layer.
#[inline(always)]
fn index(axis: usize, z: usize, bit: usize) -> usize {
    AXIS * axis + WIDE * WIDE * z + WIDE * (bit >> 3) + (bit & 7)
}

/// Writes the numbers of a block's own vertices.
#[inline(always)]
fn number(numbers: &mut [u32; 3 * AXIS], block: &BlockVertices) {
    let mut number = block.first;
    for word in 0..24 {
        let mut left = block.words[word];
        while left != 0 {
            numbers[index(word / 8, word % 8, left.trailing_zeros() as usize)] = number;
            number += 1;
            left &= left - 1;
        }
    }
}

/// Writes the numbers of the vertices on the first layer beyond the block along one or two axes.
#[inline(always)]
fn number_beyond(numbers: &mut [u32; 3 * AXIS], neighbours: &Neighbours, vertices: &[BlockVertices], n: usize) {
    for beyond in 1..7 {
        let [dx, dy, dz] = [beyond & 1, beyond >> 1 & 1, beyond >> 2];
        let neighbour = CENTRE + dx + 3 * dy + 9 * dz;
        if neighbours.native >> neighbour & 1 == 0 {
            continue;
        }
        let block = &vertices[neighbours.ranks[neighbour] as usize];
        let layers = if dz == 1 { 1 } else { n };
        let columns = if dx == 1 { 0x0101_0101_0101_0101 } else { u64::MAX };
        let face = if dy == 1 { columns & 0xff } else { columns };
        let shift = n * (dx + WIDE * (dy + WIDE * dz));
        for axis in 0..3 {
            // An edge along an axis begins beyond the block in the two others only.
            if beyond >> axis & 1 == 1 {
                continue;
            }
            for z in 0..layers {
                let mut left = block.words[8 * axis + z] & face;
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    numbers[index(axis, z, bit) + shift] = block.number(8 * axis + z, bit);
                }
            }
        }
    }
}
