//! Vertices and triangles of a part of the blocks, before vertices have numbers.
//!
//! A vertex lies on a dual edge, between two voxels that share a face. The finer of the two owns it (the lower one among equals), so block,
//! direction and voxel identify it. A block's vertices are bits of a mask, and counting them numbers the vertices.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use crate::simd::bits::rank;
use bytemuck::Zeroable;
use std::ops::Range;

/// The vertices of a block. Words 0 to 23: a bit per voxel, layer by layer, for the edge to the next voxel along x, y and z. Words 24 to 26: a bit
/// per voxel on the block's lower faces for the edge to a larger voxel before it.
#[derive(Clone, Copy, Zeroable)]
pub(crate) struct BlockVertices {
    pub words: [u64; 27],
    /// Number of vertices in the words before each word.
    pub before: [u16; 27],
    /// Number of the first vertex.
    pub first: u32,
}

impl BlockVertices {
    /// The number of a vertex by word and bit.
    #[inline(always)]
    pub fn number(&self, word: usize, bit: usize) -> u32 {
        self.first + u32::from(self.before[word]) + rank(self.words[word], bit) as u32
    }

    /// Word and bit of the vertex that is number `index` of the block.
    pub fn word_and_bit(&self, index: u32) -> (u8, u8) {
        let word = self.before.partition_point(|before| u32::from(*before) <= index) - 1;
        let mut bits = self.words[word];
        (0..index - u32::from(self.before[word])).for_each(|_| bits &= bits - 1);
        (word as u8, bits.trailing_zeros() as u8)
    }

    /// Number of vertices.
    #[inline(always)]
    pub fn count(&self) -> u32 {
        u32::from(self.before[26]) + self.words[26].count_ones()
    }

    /// Computes `before`.
    #[inline(always)]
    pub fn number_words(&mut self) {
        let mut count = 0;
        for i in 0..27 {
            self.before[i] = count;
            count += self.words[i].count_ones() as u16;
        }
    }
}

/// A vertex by block, word and bit.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct VertexName {
    pub rank: u32,
    pub word: u8,
    pub bit: u8,
}

impl VertexName {
    /// The vertex of the voxel with index `mask_index` in block `rank` towards direction 0..3, +x +y +z, or 3..6, -x -y -z.
    pub fn new(rank: u32, mask_index: u16, direction: usize) -> Self {
        let (layer, bit) = ((mask_index >> 6) as usize, mask_index & 63);
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

/// Cells and triangles of a part of the blocks.
#[derive(Default)]
pub(crate) struct MeshPart {
    /// Cells with all corners in blocks of one scale: cell below, case above [`CASE_SHIFT`].
    pub cells: Vec<u32>,
    /// Where each block's cells end.
    pub ends: Vec<u32>,
    /// Number of triangles of these cells, and that up to the end of each block.
    pub cell_triangles: usize,
    pub triangle_ends: Vec<u32>,
    /// Triangles where scales meet, and where each block's end.
    pub seams: Vec<[VertexName; 3]>,
    pub seam_ends: Vec<u32>,
}

impl MeshPart {
    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.cell_triangles + self.seams.len()
    }

    /// The triangles of block `i` of the part: those within its scale, and those where scales meet.
    pub fn of_block(&self, i: usize) -> [Range<usize>; 2] {
        let range = |ends: &[u32]| if i == 0 { 0 } else { ends[i - 1] as usize }..ends[i] as usize;
        let seams = range(&self.seam_ends);
        [range(&self.triangle_ends), self.cell_triangles + seams.start..self.cell_triangles + seams.end]
    }
}

/// First bit of the case of a cell; the bits below are the voxel at its lower corner as an index into 9 x 9 x 9.
pub(crate) const CASE_SHIFT: u32 = 16;
