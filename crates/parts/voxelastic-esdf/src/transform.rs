//! The exact distance transform of a box of blocks: squared distances to the nearest seed, one axis after the other. Seeds farther than the reach do not count,
//! so the box needs the seeds within that distance around it and nothing else.

use voxelastic::field::occupancy::BlockBits;
use voxelastic::octree::BLOCK_EDGE;

/// Largest reach, voxels: with a tile of four blocks, a row fits 128 bits.
pub(crate) const MAX_REACH: usize = 48;
/// No seed within reach.
const NOTHING: i16 = 16_000;
const EDGE: usize = BLOCK_EDGE;

/// A box of blocks: its first block and how many there are along each axis, one to four.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockBox {
    pub low: [i32; 3],
    pub size: [usize; 3],
}

/// Computes distances; keeps its memory from box to box.
#[derive(Debug, Default)]
pub(crate) struct Transform {
    /// Seeds in the box and around it: a bit per voxel along x, rows along y, then z.
    rows: Vec<u128>,
    /// Squared distances along x of the rows of one plane.
    along_x: Vec<i16>,
    /// Squared distances along x and y, plane by plane, of the rows that have any; and which have.
    along_xy: Vec<i16>,
    is_reached: Vec<bool>,
    /// Squared distances, x fastest, then y, then z.
    squared: Vec<i16>,
    size: [usize; 3],
}

/// What a transform needs of its seeds.
pub(crate) trait SeedBits {
    /// The seeds among the voxels of a block.
    fn of_block(&self, block: [i32; 3]) -> BlockBits;
    /// Whether no voxel is a seed in the 2 x 2 x 2 blocks that begin at a block with even coordinates; false if that is not quick to tell.
    fn are_none(&self, blocks: [i32; 3]) -> bool;
}

impl Transform {
    /// Computes the distances in `blocks` up to `reach` voxels; returns false if no seed is within reach of any voxel.
    pub fn run(&mut self, blocks: BlockBox, reach: usize, seeds: &impl SeedBits) -> bool {
        self.size = blocks.size.map(|n| n * EDGE);
        if !self.fill(blocks, reach, seeds) {
            return false;
        }
        match blocks.size[0] {
            1 => self.add_up::<8>(reach),
            2 => self.add_up::<16>(reach),
            3 => self.add_up::<24>(reach),
            _ => self.add_up::<32>(reach),
        }
        true
    }

    /// Squared distances along x, then y, then z; with rows of `N` voxels.
    fn add_up<const N: usize>(&mut self, reach: usize) {
        let [_, ny, nz] = self.size;
        let (wy, wz) = (ny + 2 * reach, nz + 2 * reach);
        self.along_x.resize(wy * N, 0);
        self.along_xy.resize(wz * ny * N, 0);
        self.is_reached.clear();
        self.is_reached.resize(wz * ny, false);
        for z in 0..wz {
            let rows = &self.rows[z * wy..(z + 1) * wy];
            let along_x = self.along_x.as_chunks_mut::<N>().0;
            let mut has_seeds = false;
            for (row, squared) in rows.iter().zip(along_x.iter_mut()).filter(|(row, _)| **row != 0) {
                *squared = distances_along_row(*row, reach);
                has_seeds = true;
            }
            if has_seeds {
                let along_x = &*along_x;
                let along_xy = &mut self.along_xy.as_chunks_mut::<N>().0[z * ny..(z + 1) * ny];
                for (y, squared) in along_xy.iter_mut().enumerate() {
                    self.is_reached[z * ny + y] = nearest_across(squared, y + reach, reach, |row| (rows[row] != 0).then(|| &along_x[row]));
                }
            }
        }
        self.squared.resize(nz * ny * N, NOTHING);
        let along_xy = self.along_xy.as_chunks::<N>().0;
        for (i, squared) in self.squared.as_chunks_mut::<N>().0.iter_mut().enumerate() {
            let (z, y) = (i / ny, i % ny);
            nearest_across(squared, z + reach, reach, |plane| self.is_reached[plane * ny + y].then(|| &along_xy[plane * ny + y]));
        }
    }

    /// Squared distances of the voxels of block `at` of the box, in the order of a block's finest voxels; `far` beyond the reach.
    pub fn block(&self, at: [usize; 3], reach: usize, far: u16) -> [u16; 512] {
        let [nx, ny, _] = self.size;
        let mut distances = [far; 512];
        let limit = (reach * reach) as i16;
        for (row, out) in distances.as_chunks_mut::<EDGE>().0.iter_mut().enumerate() {
            let (y, z) = (at[1] * EDGE + row % EDGE, at[2] * EDGE + row / EDGE);
            let first = (z * ny + y) * nx + at[0] * EDGE;
            for (out, squared) in out.iter_mut().zip(&self.squared[first..first + EDGE]) {
                *out = if *squared <= limit { *squared as u16 } else { far };
            }
        }
        distances
    }

    /// Reads the seeds in the box and within reach around it; returns whether there are any.
    fn fill(&mut self, blocks: BlockBox, reach: usize, seeds: &impl SeedBits) -> bool {
        let window = self.size.map(|n| n + 2 * reach);
        self.rows.clear();
        self.rows.resize(window[1] * window[2], 0);
        let pad = reach.div_ceil(EDGE) as i32;
        let ends = |k: usize| [blocks.low[k] - pad, blocks.low[k] + blocks.size[k] as i32 + pad];
        let [x_ends, y_ends, z_ends] = [ends(0), ends(1), ends(2)];
        let mut any = false;
        // Two by two along each axis, from even coordinates.
        let pairs = |[low, high]: [i32; 2]| (low & !1..high).step_by(2);
        let both = |pair: i32, [low, high]: [i32; 2]| pair.max(low)..(pair + 2).min(high);
        for pz in pairs(z_ends) {
            for py in pairs(y_ends) {
                for px in pairs(x_ends) {
                    if seeds.are_none([px, py, pz]) {
                        continue;
                    }
                    for bz in both(pz, z_ends) {
                        for by in both(py, y_ends) {
                            for bx in both(px, x_ends) {
                                any |= self.set(blocks.low, [bx, by, bz], reach, window, seeds.of_block([bx, by, bz]));
                            }
                        }
                    }
                }
            }
        }
        any
    }

    /// Sets the bits of a block in its rows; returns whether any is in the window.
    fn set(&mut self, low: [i32; 3], block: [i32; 3], reach: usize, window: [usize; 3], bits: BlockBits) -> bool {
        if bits == [0; 8] {
            return false;
        }
        let [x, y, z]: [i32; 3] = std::array::from_fn(|k| reach as i32 + (block[k] - low[k]) * EDGE as i32);
        let inside = u128::MAX >> (128 - window[0]);
        let mut any = 0;
        for (z, word) in (z..).zip(bits).filter(|(z, word)| (0..window[2] as i32).contains(z) && *word != 0) {
            for (y, byte) in (y..).zip(word.to_le_bytes()).filter(|(y, byte)| (0..window[1] as i32).contains(y) && *byte != 0) {
                let byte = u128::from(byte);
                let row = if x >= 0 { byte << x } else { byte >> -x } & inside;
                self.rows[z as usize * window[1] + y as usize] |= row;
                any |= row;
            }
        }
        any != 0
    }
}

/// Squares of the whole numbers from `-LARGEST` to `LARGEST`.
static SQUARES: [i16; 2 * LARGEST + 1] = {
    let mut squares = [0; 2 * LARGEST + 1];
    let mut i = 0;
    while i < squares.len() {
        let distance = i as i16 - LARGEST as i16;
        squares[i] = distance * distance;
        i += 1;
    }
    squares
};
const LARGEST: usize = 127;

/// For each byte: zero where a bit is set, [`NOTHING`] where it is not.
static OF_BITS: [[i16; 8]; 256] = {
    let mut of_bits = [[NOTHING; 8]; 256];
    let mut i = 0;
    while i < 8 * 256 {
        if ((i / 8) >> (i % 8)) & 1 == 1 {
            of_bits[i / 8][i % 8] = 0;
        }
        i += 1;
    }
    of_bits
};

/// Squared distances to the nearest set bit of a row, for the voxels that begin `reach` bits after its first. They may be larger than the reach.
#[inline]
fn distances_along_row<const N: usize>(row: u128, reach: usize) -> [i16; N] {
    let mut squared = [NOTHING; N];
    let inside = (row >> reach) as u32;
    for (squared, byte) in squared.as_chunks_mut::<8>().0.iter_mut().zip(inside.to_le_bytes()) {
        *squared = OF_BITS[usize::from(byte)];
    }
    let mut lower_to = |bit: usize| {
        let squares = &SQUARES[LARGEST + reach - bit..][..N];
        squared.iter_mut().zip(squares).for_each(|(squared, square)| *squared = (*squared).min(*square));
    };
    // The last bit before, the ends of runs of bits, the first bit after.
    let before = row & ((1u128 << reach) - 1);
    if before != 0 {
        lower_to(127 - before.leading_zeros() as usize);
    }
    let mut ends = ((row & !(row << 1 & row >> 1)) >> reach) as u32 & (u32::MAX >> (32 - N));
    while ends != 0 {
        lower_to(reach + ends.trailing_zeros() as usize);
        ends &= ends - 1;
    }
    let after = row >> (reach + N);
    if after != 0 {
        lower_to(reach + N + after.trailing_zeros() as usize);
    }
    squared
}

/// The least of the rows around `at` with the squares of their distances from it; nearest rows first, until no farther row can be less. Returns whether there are any.
#[inline]
fn nearest_across<'a, const N: usize>(squared: &mut [i16; N], at: usize, reach: usize, row: impl Fn(usize) -> Option<&'a [i16; N]>) -> bool {
    let mut nearest = [NOTHING; N];
    let mut any = false;
    let lower = |nearest: &mut [i16; N], at: usize, across: i16| {
        let row = row(at);
        if let Some(row) = row {
            nearest.iter_mut().zip(row).for_each(|(nearest, row)| *nearest = (*nearest).min(*row + across));
        }
        row.is_some()
    };
    any |= lower(&mut nearest, at, 0);
    for offset in 1..=reach {
        let across = (offset * offset) as i16;
        if any && offset.is_power_of_two() && most(&nearest) <= across {
            break;
        }
        any |= lower(&mut nearest, at - offset, across);
        any |= lower(&mut nearest, at + offset, across);
    }
    *squared = nearest;
    any
}

/// The largest of some numbers, eight at a time.
#[inline]
fn most<const N: usize>(numbers: &[i16; N]) -> i16 {
    let mut most = [0i16; 8];
    for eight in numbers.as_chunks::<8>().0 {
        most.iter_mut().zip(eight).for_each(|(most, v)| *most = (*most).max(*v));
    }
    most.into_iter().fold(0, i16::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct List<'a>(&'a [[i32; 3]]);

    impl SeedBits for List<'_> {
        fn of_block(&self, block: [i32; 3]) -> BlockBits {
            let mut bits = [0u64; 8];
            for seed in self.0.iter().filter(|seed| seed.map(|c| c >> 3) == block) {
                let [x, y, z] = seed.map(|c| (c & 7) as usize);
                bits[z] |= 1 << (x + 8 * y);
            }
            bits
        }

        fn are_none(&self, blocks: [i32; 3]) -> bool {
            assert!(blocks.iter().all(|c| c % 2 == 0));
            !self.0.iter().any(|seed| seed.map(|c| c >> 4 << 1) == blocks)
        }
    }

    /// Some seeds far apart, and some crowded, so that they are next to each other along all axes.
    fn some_seeds() -> impl Strategy<Value = Vec<[i32; 3]>> {
        let crowd = (prop::array::uniform3(-8i32..30), prop::collection::vec(prop::array::uniform3(0i32..4), 0..60));
        let crowded =
            crowd.prop_map(|(corner, seeds)| seeds.into_iter().map(|seed| std::array::from_fn(|k| corner[k] + seed[k])).collect::<Vec<_>>());
        (prop::collection::vec(prop::array::uniform3(-60i32..90), 0..12), crowded).prop_map(|(a, b)| [a, b].concat())
    }

    proptest! {
        #[test]
        fn a_box_has_the_distances_of_all_pairs(
            seeds in some_seeds(),
            size in prop::array::uniform3(1usize..=4),
            reach in 1usize..=MAX_REACH,
        ) {
            let bits = List(&seeds);
            let mut transform = Transform::default();
            // Memory of an earlier box must not show.
            transform.run(BlockBox { low: [-1; 3], size: [2; 3] }, 7, &bits);
            let found = transform.run(BlockBox { low: [0; 3], size }, reach, &bits);
            for block in 0..size[0] * size[1] * size[2] {
                let at = [block % size[0], block / size[0] % size[1], block / size[0] / size[1]];
                let distances = if found { transform.block(at, reach, u16::MAX) } else { [u16::MAX; 512] };
                for (i, &squared) in distances.iter().enumerate() {
                    let c = [i & 7, i >> 3 & 7, i >> 6];
                    let p: [i32; 3] = std::array::from_fn(|k| (at[k] * 8 + c[k]) as i32);
                    let nearest = seeds.iter().map(|s| (0..3).map(|k| (s[k] - p[k]).pow(2)).sum::<i32>()).min();
                    let expected = nearest.filter(|d| *d <= (reach * reach) as i32).map_or(u16::MAX, |d| d as u16);
                    prop_assert_eq!(squared, expected, "voxel {:?}, reach {}", p, reach);
                }
            }
        }
    }
}
