//! Blocks in Morton order with their neighbours.

use super::resolved_blocks::ResolvedBlocks;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, block_coords, block_key, edge_at};
use rayon::prelude::*;

/// log2 of the blocks per part: few enough for an even load of threads, many enough that most triangles are within a part.
const PART_SHIFT: u32 = 10;
/// Blocks that a thread processes at a time. The order of the result depends on these parts, not on threads.
pub(crate) const PART: usize = 1 << PART_SHIFT;

/// Edge in blocks of the cubes whose blocks look up their neighbours together.
const CUBE: usize = 4;
/// Key bits of a block within such a cube.
const CUBE_BITS: u32 = 6;
/// Edge of such a cube with a margin of one block.
const PADDED: usize = CUBE + 2;
const PADDED_BLOCKS: usize = PADDED * PADDED * PADDED;

/// The block itself among the 27 around it, x fastest.
pub(crate) const CENTRE: usize = 13;

/// A block. Blocks are identified by their *rank*, their index in Morton order.
#[derive(Clone, Copy)]
pub(crate) struct BlockHead {
    pub id: u32,
    pub scale: u8,
    pub key: u64,
}

impl BlockHead {
    /// Edge in voxels.
    #[inline(always)]
    pub fn edge(&self) -> usize {
        edge_at(self.scale.into())
    }

    /// Smallest corner in finest voxels.
    #[inline(always)]
    pub fn origin(&self) -> [i32; 3] {
        let [x, y, z] = block_coords(self.key);
        [x * BLOCK_EDGE as i32, y * BLOCK_EDGE as i32, z * BLOCK_EDGE as i32]
    }
}

/// The 27 blocks around a block, itself included, x fastest.
#[derive(Clone, Copy)]
pub(crate) struct Neighbours {
    /// Ranks; [`NONE`] where there is no block.
    pub ranks: [u32; 27],
    /// Bits of those with the block's scale ...
    pub native: u32,
    /// ... of coarser ones ...
    pub coarser: u32,
    /// ... and of finer ones.
    pub finer: u32,
}

impl Neighbours {
    const EMPTY: Self = Self { ranks: [NONE; 27], native: 0, coarser: 0, finer: 0 };
}

/// Blocks of a field, by rank.
pub(crate) struct BlockGrid {
    pub heads: Vec<BlockHead>,
    pub neighbours: Vec<Neighbours>,
}

impl BlockGrid {
    pub fn new(resolved: &ResolvedBlocks<'_>) -> Self {
        let head = |id: u32| BlockHead { id, scale: resolved.scale(id) as u8, key: resolved.field.block(id).key };
        let heads: Vec<BlockHead> = resolved.ids.par_iter().copied().with_min_len(PART).map(head).collect();
        let mut ranks = vec![NONE; resolved.field.ids().len()];
        heads.iter().zip(0..).for_each(|(head, rank)| ranks[head.id as usize] = rank);
        let mut neighbours = vec![Neighbours::EMPTY; heads.len()];
        (neighbours.par_chunks_mut(PART), heads.par_chunks(PART)).into_par_iter().for_each(|(mut neighbours, part)| {
            let mut cube = BlockCube { heads: &heads, of_id: &ranks, ranks: [NONE; PADDED_BLOCKS], scales: [0; PADDED_BLOCKS] };
            let mut cursor = Cursor::new(resolved.field.tree());
            for members in part.chunk_by(|a, b| a.key >> CUBE_BITS == b.key >> CUBE_BITS) {
                cube.load(resolved, &mut cursor, members[0].key);
                let (these, rest) = std::mem::take(&mut neighbours).split_at_mut(members.len());
                members.iter().zip(these).for_each(|(head, neighbours)| *neighbours = cube.neighbours(head));
                neighbours = rest;
            }
        });
        Self { heads, neighbours }
    }
}

/// The part that contains block `rank`.
#[inline(always)]
pub(crate) fn part_of(rank: usize) -> usize {
    rank >> PART_SHIFT
}

/// Offsets of the 27 blocks in a padded cube from the first of them.
const OFFSETS: [usize; 27] = {
    let mut offsets = [0; 27];
    let mut i = 0;
    while i < 27 {
        offsets[i] = i % 3 + PADDED * (i / 3 % 3 + PADDED * (i / 9));
        i += 1;
    }
    offsets
};

/// Ranks of the blocks of a cube and of a margin around it.
struct BlockCube<'a> {
    heads: &'a [BlockHead],
    of_id: &'a [u32],
    ranks: [u32; PADDED_BLOCKS],
    /// Their scales; undefined where there is no block.
    scales: [u8; PADDED_BLOCKS],
}

impl BlockCube<'_> {
    /// Looks up the cube that contains block `key`.
    fn load(&mut self, resolved: &ResolvedBlocks<'_>, cursor: &mut Cursor, key: u64) {
        let low = block_coords(key >> CUBE_BITS << CUBE_BITS).map(|c| c - 1);
        // Groups of eight siblings one after another, so that the cursor is fast: the first group lies around the cube's lowest corner.
        for group in 0..64usize {
            let first = [group & 3, group >> 2 & 3, group >> 4].map(|c| 2 * c);
            let key = block_key([0, 1, 2].map(|k| low[k] + first[k] as i32 - 1));
            for sibling in 0..8usize {
                let [x, y, z] = [0, 1, 2].map(|k| (first[k] + (sibling >> k & 1)).wrapping_sub(1));
                if x >= PADDED || y >= PADDED || z >= PADDED {
                    continue;
                }
                let (i, id) = (x + PADDED * (y + PADDED * z), cursor.block(resolved.field.tree(), key | sibling as u64));
                self.ranks[i] = NONE;
                // A block of the field that is not one of these has no rank.
                if let Some(rank) = id.map(|id| self.of_id[id as usize]).filter(|rank| *rank != NONE) {
                    self.ranks[i] = rank;
                    self.scales[i] = self.heads[rank as usize].scale;
                }
            }
        }
    }

    /// The neighbours of a block of the cube.
    fn neighbours(&self, head: &BlockHead) -> Neighbours {
        let low = block_coords(head.key >> CUBE_BITS << CUBE_BITS);
        let [x, y, z] = block_coords(head.key);
        let corner = (x - low[0]) as usize + PADDED * ((y - low[1]) as usize + PADDED * (z - low[2]) as usize);
        let mut neighbours = Neighbours::EMPTY;
        for (i, offset) in OFFSETS.iter().enumerate() {
            let at = corner + offset;
            let (rank, scale) = (self.ranks[at], self.scales[at]);
            let exists = rank != NONE;
            neighbours.ranks[i] = rank;
            neighbours.native |= u32::from(exists & (scale == head.scale)) << i;
            neighbours.coarser |= u32::from(exists & (scale > head.scale)) << i;
            neighbours.finer |= u32::from(exists & (scale < head.scale)) << i;
        }
        neighbours
    }
}

/// Offset in blocks of neighbour `i` of 27.
#[inline(always)]
pub(crate) fn neighbour_offset(i: usize) -> [i32; 3] {
    [(i % 3) as i32 - 1, (i / 3 % 3) as i32 - 1, (i / 9) as i32 - 1]
}
