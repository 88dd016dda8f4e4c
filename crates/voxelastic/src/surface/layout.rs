//! Blocks in Morton order, each with the blocks around it.

use super::view::View;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, block_coords, block_key, edge_at};
use rayon::prelude::*;

/// log2 of the blocks per part: few enough that threads share evenly, many enough that most triangles stay among them.
const PART_SHIFT: u32 = 10;
/// Blocks that a thread takes at a time: neighbours in space. They, not the threads, decide the order of everything.
pub(super) const PART: usize = 1 << PART_SHIFT;

/// Edge in blocks of the cubes whose blocks find their neighbours together.
const CUBE: usize = 4;
/// Key bits below such a cube.
const CUBE_BITS: u32 = 6;
/// The same with a rim of one block.
const RIMMED: usize = CUBE + 2;
const RIMMED_BLOCKS: usize = RIMMED * RIMMED * RIMMED;

/// The block itself among the 27 around it, x fastest.
pub(super) const CENTRE: usize = 13;

/// A block. Blocks are known by their *rank*, their place in Morton order.
#[derive(Clone, Copy)]
pub(super) struct Head {
    pub id: u32,
    pub scale: u8,
    key: u64,
}

impl Head {
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
pub(super) struct Around {
    /// Ranks; [`NONE`] where there is no block.
    pub ranks: [u32; 27],
    /// Which of them have the block's scale, a bit each ...
    pub native: u32,
    /// ... a coarser one ...
    pub coarser: u32,
    /// ... or a finer one.
    pub finer: u32,
}

impl Around {
    const NOTHING: Self = Self { ranks: [NONE; 27], native: 0, coarser: 0, finer: 0 };
}

/// All blocks of a field, by rank.
pub(super) struct Layout {
    pub heads: Vec<Head>,
    pub around: Vec<Around>,
}

impl Layout {
    pub fn new(view: &View<'_>) -> Self {
        let head = |id: u32| Head { id, scale: view.scale(id) as u8, key: view.field.block(id).key };
        let heads: Vec<Head> = view.field.ids_in_morton_order().into_par_iter().with_min_len(PART).map(head).collect();
        let mut ranks = vec![NONE; view.field.ids().len()];
        heads.iter().zip(0..).for_each(|(head, rank)| ranks[head.id as usize] = rank);
        let mut around = vec![Around::NOTHING; heads.len()];
        (around.par_chunks_mut(PART), heads.par_chunks(PART)).into_par_iter().for_each(|(mut around, part)| {
            let mut cube = Cube { heads: &heads, of_id: &ranks, ranks: [NONE; RIMMED_BLOCKS], scales: [0; RIMMED_BLOCKS] };
            let mut cursor = Cursor::new(view.field.tree());
            for members in part.chunk_by(|a, b| a.key >> CUBE_BITS == b.key >> CUBE_BITS) {
                cube.load(view, &mut cursor, members[0].key);
                let (these, rest) = std::mem::take(&mut around).split_at_mut(members.len());
                members.iter().zip(these).for_each(|(head, around)| *around = cube.around(head));
                around = rest;
            }
        });
        Self { heads, around }
    }
}

/// Which part block `rank` belongs to.
#[inline(always)]
pub(super) fn part_of(rank: usize) -> usize {
    rank >> PART_SHIFT
}

/// From the first of 27 blocks in a rimmed cube to each.
const OFFSETS: [usize; 27] = {
    let mut offsets = [0; 27];
    let mut i = 0;
    while i < 27 {
        offsets[i] = i % 3 + RIMMED * (i / 3 % 3 + RIMMED * (i / 9));
        i += 1;
    }
    offsets
};

/// Ranks of the blocks of a cube and of a rim around it.
struct Cube<'a> {
    heads: &'a [Head],
    of_id: &'a [u32],
    ranks: [u32; RIMMED_BLOCKS],
    /// Their scales; anything where there is none.
    scales: [u8; RIMMED_BLOCKS],
}

impl Cube<'_> {
    /// Loads the cube that block `key` lies in.
    fn load(&mut self, view: &View<'_>, cursor: &mut Cursor, key: u64) {
        let low = block_coords(key >> CUBE_BITS << CUBE_BITS).map(|c| c - 1);
        // Eight siblings after each other, which the cursor has at hand: the first of them lie around the cube's lowest corner.
        for group in 0..64usize {
            let first = [group & 3, group >> 2 & 3, group >> 4].map(|c| 2 * c);
            let key = block_key([0, 1, 2].map(|k| low[k] + first[k] as i32 - 1));
            for sibling in 0..8usize {
                let [x, y, z] = [0, 1, 2].map(|k| (first[k] + (sibling >> k & 1)).wrapping_sub(1));
                if x >= RIMMED || y >= RIMMED || z >= RIMMED {
                    continue;
                }
                let (i, id) = (x + RIMMED * (y + RIMMED * z), cursor.block(view.field.tree(), key | sibling as u64));
                self.ranks[i] = NONE;
                if let Some(id) = id {
                    self.ranks[i] = self.of_id[id as usize];
                    self.scales[i] = self.heads[self.ranks[i] as usize].scale;
                }
            }
        }
    }

    /// What lies around a block of the cube.
    fn around(&self, head: &Head) -> Around {
        let low = block_coords(head.key >> CUBE_BITS << CUBE_BITS);
        let [x, y, z] = block_coords(head.key);
        let corner = (x - low[0]) as usize + RIMMED * ((y - low[1]) as usize + RIMMED * (z - low[2]) as usize);
        let mut around = Around::NOTHING;
        for (i, offset) in OFFSETS.iter().enumerate() {
            let at = corner + offset;
            let (rank, scale) = (self.ranks[at], self.scales[at]);
            let exists = rank != NONE;
            around.ranks[i] = rank;
            around.native |= u32::from(exists & (scale == head.scale)) << i;
            around.coarser |= u32::from(exists & (scale > head.scale)) << i;
            around.finer |= u32::from(exists & (scale < head.scale)) << i;
        }
        around
    }
}

/// Offset in blocks of neighbour `i` of 27.
#[inline(always)]
pub(super) fn neighbour_offset(i: usize) -> [i32; 3] {
    [(i % 3) as i32 - 1, (i / 3 % 3) as i32 - 1, (i / 9) as i32 - 1]
}
