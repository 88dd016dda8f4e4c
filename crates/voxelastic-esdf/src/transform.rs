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
    /// Squared distances along x and y, plane by plane; and which planes have any.
    along_xy: Vec<i16>,
    has_seeds: Vec<bool>,
    /// Squared distances, x fastest, then y, then z.
    squared: Vec<i16>,
    size: [usize; 3],
}

impl Transform {
    /// Computes the distances in `blocks` up to `reach` voxels; returns false if no seed is within reach of any voxel.
    pub fn run(&mut self, blocks: BlockBox, reach: usize, seeds: impl Fn([i32; 3]) -> BlockBits) -> bool {
        self.size = blocks.size.map(|n| n * EDGE);
        if !self.fill(blocks, reach, seeds) {
            return false;
        }
        let [nx, ny, nz] = self.size;
        let (wy, wz) = (ny + 2 * reach, nz + 2 * reach);
        self.along_x.resize(wy * nx, 0);
        self.along_xy.clear();
        self.along_xy.resize(wz * ny * nx, NOTHING);
        self.has_seeds.clear();
        self.has_seeds.resize(wz, false);
        for z in 0..wz {
            let rows = &self.rows[z * wy..(z + 1) * wy];
            let seeded: Vec<usize> = (0..wy).filter(|y| rows[*y] != 0).collect();
            self.has_seeds[z] = !seeded.is_empty();
            for &y in &seeded {
                distances_along_row(rows[y], reach, &mut self.along_x[y * nx..(y + 1) * nx]);
            }
            for (y, nearest) in self.along_xy[z * ny * nx..(z + 1) * ny * nx].chunks_exact_mut(nx).enumerate() {
                let from = seeded.partition_point(|row| *row < y);
                for &row in seeded[from..].iter().take_while(|row| **row <= y + 2 * reach) {
                    add_square(nearest, &self.along_x[row * nx..(row + 1) * nx], row.abs_diff(y + reach));
                }
            }
        }
        self.squared.clear();
        self.squared.resize(nz * ny * nx, NOTHING);
        for (z, nearest) in self.squared.chunks_exact_mut(ny * nx).enumerate() {
            for plane in (z..=z + 2 * reach).filter(|plane| self.has_seeds[*plane]) {
                add_square(nearest, &self.along_xy[plane * ny * nx..(plane + 1) * ny * nx], plane.abs_diff(z + reach));
            }
        }
        true
    }

    /// Squared distances of the voxels of block `at` of the box, in the order of a block's finest voxels; `far` beyond the reach.
    pub fn block(&self, at: [usize; 3], reach: usize, far: u16) -> [u16; 512] {
        let [nx, ny, _] = self.size;
        let mut distances = [far; 512];
        for (row, out) in distances.as_chunks_mut::<EDGE>().0.iter_mut().enumerate() {
            let (y, z) = (at[1] * EDGE + row % EDGE, at[2] * EDGE + row / EDGE);
            let first = (z * ny + y) * nx + at[0] * EDGE;
            for (out, squared) in out.iter_mut().zip(&self.squared[first..first + EDGE]) {
                let squared = *squared as u16;
                *out = if usize::from(squared) <= reach * reach { squared } else { far };
            }
        }
        distances
    }

    /// Reads the seeds in the box and within reach around it; returns whether there are any.
    fn fill(&mut self, blocks: BlockBox, reach: usize, seeds: impl Fn([i32; 3]) -> BlockBits) -> bool {
        let window = self.size.map(|n| n + 2 * reach);
        self.rows.clear();
        self.rows.resize(window[1] * window[2], 0);
        let pad = reach.div_ceil(EDGE) as i32;
        let range = |k: usize| -pad..blocks.size[k] as i32 + pad;
        let first = |block: i32| reach as i32 + block * EDGE as i32;
        let inside = u128::MAX >> (128 - window[0]);
        let mut any = false;
        for bz in range(2) {
            for by in range(1) {
                for bx in range(0) {
                    let bits = seeds([blocks.low[0] + bx, blocks.low[1] + by, blocks.low[2] + bz]);
                    if bits == [0; 8] {
                        continue;
                    }
                    for (z, word) in (first(bz)..).zip(bits).filter(|(z, word)| (0..window[2] as i32).contains(z) && *word != 0) {
                        for (y, byte) in (first(by)..).zip(word.to_le_bytes()).filter(|(y, byte)| (0..window[1] as i32).contains(y) && *byte != 0) {
                            let (byte, shift) = (u128::from(byte), first(bx));
                            let row = if shift >= 0 { byte << shift } else { byte >> -shift } & inside;
                            self.rows[z as usize * window[1] + y as usize] |= row;
                            any |= row != 0;
                        }
                    }
                }
            }
        }
        any
    }
}

/// Squared distances to the nearest set bit of a row, for the voxels that begin `reach` bits after its first.
fn distances_along_row(row: u128, reach: usize, squared: &mut [i16]) {
    let mut nearest = [i16::from(u8::MAX); 4 * EDGE];
    let nearest = &mut nearest[..squared.len()];
    let beyond = reach as i16 + 1;
    // Distances from the last bit before, then from the first bit after.
    let before = row & ((1u128 << reach) - 1);
    let mut distance = if before == 0 { beyond } else { (reach as i16 - 1) - (127 - before.leading_zeros() as i16) };
    let bits = row >> reach;
    for (x, nearest) in nearest.iter_mut().enumerate() {
        distance = if bits >> x & 1 == 1 { 0 } else { (distance + 1).min(beyond) };
        *nearest = distance;
    }
    let after = bits >> squared.len();
    distance = if after == 0 { beyond } else { after.trailing_zeros() as i16 };
    for (x, nearest) in nearest.iter_mut().enumerate().rev() {
        distance = if bits >> x & 1 == 1 { 0 } else { (distance + 1).min(beyond) };
        *nearest = (*nearest).min(distance);
    }
    for (squared, distance) in squared.iter_mut().zip(nearest) {
        *squared = if *distance < beyond { *distance * *distance } else { NOTHING };
    }
}

/// Lowers `nearest` to `other` at a distance of `offset` voxels across.
fn add_square(nearest: &mut [i16], other: &[i16], offset: usize) {
    let across = (offset * offset) as i16;
    for (nearest, other) in nearest.iter_mut().zip(other) {
        *nearest = (*nearest).min(*other + across);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_box_has_the_distances_of_all_pairs(
            seeds in prop::collection::vec(prop::array::uniform3(-60i32..90), 0..12),
            size in prop::array::uniform3(1usize..=4),
            reach in 1usize..=MAX_REACH,
        ) {
            let bits = |block: [i32; 3]| {
                let mut bits = [0u64; 8];
                for seed in seeds.iter().filter(|seed| seed.map(|c| c >> 3) == block) {
                    let [x, y, z] = seed.map(|c| (c & 7) as usize);
                    bits[z] |= 1 << (x + 8 * y);
                }
                bits
            };
            let mut transform = Transform::default();
            // Memory of an earlier box must not show.
            transform.run(BlockBox { low: [-1; 3], size: [2; 3] }, 7, bits);
            let found = transform.run(BlockBox { low: [0; 3], size }, reach, bits);
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
