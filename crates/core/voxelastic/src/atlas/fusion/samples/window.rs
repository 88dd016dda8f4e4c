//! The source around a box of the target, at one scale: which cells have observed voxels, and where their voxels lie.
//!
//! A *cell* is the cube between the centres of eight neighbouring voxels, named by the lowest of them.

use super::decoded_blocks::{Arrays, DecodedBlocks};
use super::trilinear::CellArrays;
use crate::atlas::fusion::placement::Placement;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_key, edge_at, voxels_at};

/// Cells a window reaches beyond its box, voxels: one for the cell around a point, one for rounding.
const MARGIN: f32 = 2.0;

/// A box of the target's lattice: centre and half extents, finest voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TargetBox {
    pub centre: [f32; 3],
    pub half: [f32; 3],
    /// What is added to coordinates in the source: its mean over the box, and the largest difference from it along an axis.
    pub offset: [f32; 3],
    pub spread: f32,
}

/// Bits of the cells of a window: rows along x, then y, then z.
#[derive(Default)]
struct CellBits {
    words: Vec<u32>,
    /// Words per row, and rows along y and z.
    size: [usize; 3],
}

impl CellBits {
    fn clear(&mut self, voxels: [usize; 3]) {
        self.size = [voxels[0].div_ceil(32), voxels[1], voxels[2]];
        self.words.clear();
        self.words.resize(self.size.iter().product(), 0);
    }

    /// Sets `bits` from voxel `c` on; they do not cross a word.
    fn set(&mut self, c: [usize; 3], bits: u8) {
        self.words[(c[2] * self.size[1] + c[1]) * self.size[0] + c[0] / 32] |= u32::from(bits) << (c[0] % 32);
    }

    /// From voxels to the cells that have them as corners: those whose lowest voxel is up to one voxel lower along each axis.
    fn spread_to_cells(&mut self) {
        let [row, rows, _] = self.size;
        for words in self.words.chunks_exact_mut(row) {
            for i in 0..row {
                let next = words.get(i + 1).copied().unwrap_or(0);
                words[i] |= words[i] >> 1 | next << 31;
            }
        }
        for plane in self.words.chunks_exact_mut(row * rows) {
            or_later(plane, row);
        }
        or_later(&mut self.words, row * rows);
    }
}

/// Adds the word `ahead` words later to each word.
fn or_later(words: &mut [u32], ahead: usize) {
    for i in ahead..words.len() {
        words[i - ahead] |= words[i];
    }
}

/// The source around a box of the target at one scale. It can be filled again and again.
#[derive(Default)]
pub(crate) struct Window {
    scale: usize,
    /// Its lowest voxel, and its size in blocks.
    low: [i32; 3],
    blocks: [usize; 3],
    /// First voxel of the array of each block: that of the unobserved array if there is none at this scale.
    starts: Vec<u32>,
    observed: CellBits,
    /// Cells that touch a block of a coarser scale, if there are any.
    coarser: CellBits,
    has_coarser: bool,
}

impl Window {
    /// Fills the window with what is around `target` at `scale`.
    pub fn fill(&mut self, source: &mut DecodedBlocks<'_>, cursor: &mut Cursor, placement: &Placement, target: &TargetBox, scale: usize) {
        let (edge, block) = ((1 << scale) as f32, BLOCK_EDGE as f32);
        let (centre, half) = placement.cuboid_in_source(target.centre, target.half);
        let (mut first, mut size) = ([0; 3], [0; 3]);
        for k in 0..3 {
            let (centre, reach) = (centre[k] + target.offset[k], half[k] + MARGIN * edge + target.spread);
            first[k] = ((centre - reach) / block).floor() as i32;
            size[k] = (((centre + reach) / block).floor() as i32 - first[k] + 1) as usize;
        }
        (self.scale, self.blocks, self.low) = (scale, size, first.map(|c| c << (BLOCK_SHIFT as usize - scale)));
        let n = edge_at(scale);
        self.observed.clear(size.map(|blocks| blocks * n));
        self.has_coarser = false;
        // Creates the unobserved array.
        source.prepare(scale);
        self.starts.clear();
        // Blocks whose voxels cannot be corners of a cell around a point of the target are left out.
        let rotation = &placement.t_target_source.rotation;
        let reach: [f32; 3] = std::array::from_fn(|k| {
            target.half[k] + MARGIN * edge + (0.5 * block + target.spread) * rotation[k].iter().map(|r| r.abs()).sum::<f32>()
        });
        for z in 0..size[2] {
            for y in 0..size[1] {
                let row = [first[0], first[1] + y as i32, first[2] + z as i32];
                let middle = placement.t_target_source.apply(std::array::from_fn(|k| (row[k] as f32 + 0.5) * block - target.offset[k]));
                for x in 0..size[0] {
                    let is_near = (0..3).all(|k| (middle[k] + x as f32 * block * rotation[k][0] - target.centre[k]).abs() <= reach[k]);
                    let id = if is_near { source.find(cursor, block_key([row[0] + x as i32, row[1], row[2]])) } else { None };
                    let number = id.map_or(0, |id| self.add(source, id, [x, y, z].map(|v| v * n)));
                    self.starts.push(number * voxels_at(scale) as u32);
                }
            }
        }
        self.observed.spread_to_cells();
        if self.has_coarser {
            self.coarser.spread_to_cells();
        }
    }

    /// Adds block `id`, whose lowest voxel in the window is `corner`, and returns the number of its array.
    fn add(&mut self, source: &mut DecodedBlocks<'_>, id: u32, corner: [usize; 3]) -> u32 {
        let n = edge_at(self.scale);
        if !source.is_resolved_at(id, self.scale) {
            if !self.has_coarser {
                self.coarser.clear(self.blocks.map(|blocks| blocks * n));
                self.has_coarser = true;
            }
            for (y, z) in (0..n * n).map(|i| (i % n, i / n)) {
                self.coarser.set([corner[0], corner[1] + y, corner[2] + z], u8::MAX >> (BLOCK_EDGE - n));
            }
            return 0;
        }
        let number = source.number(id, self.scale);
        let observed = &source.at(self.scale).observed[number as usize];
        for (y, z) in (0..n * n).map(|i| (i % n, i / n)) {
            self.observed.set([corner[0], corner[1] + y, corner[2] + z], observed[y + BLOCK_EDGE * z]);
        }
        number
    }

    /// The bits of the cells with observed voxels, as rows.
    pub fn observed(&self) -> CellRows<'_> {
        self.rows(&self.observed)
    }

    /// The bits of the cells that touch a coarser block, as rows; none if there are none.
    pub fn coarser(&self) -> Option<CellRows<'_>> {
        self.has_coarser.then(|| self.rows(&self.coarser))
    }

    fn rows<'a>(&self, bits: &'a CellBits) -> CellRows<'a> {
        let [words, rows, _] = bits.size;
        CellRows {
            words: &bits.words,
            row: words as u32,
            plane: (words * rows) as u32,
            low: self.low,
            size: self.blocks.map(|n| (n * edge_at(self.scale)) as u32 - 1),
        }
    }

    /// Where the voxels of the cells lie in `source`, from which the window was filled.
    pub fn cells<'a>(&'a self, source: &'a DecodedBlocks<'_>) -> CellArrays<'a> {
        let Arrays { voxels, intensities, .. } = source.at(self.scale);
        CellArrays { scale: self.scale, low: self.low, blocks: self.blocks.map(|v| v as u32), starts: &self.starts, voxels, intensities }
    }
}

/// A bit per cell. Cells of which a corner is outside of the window are not among them.
#[derive(Clone, Copy)]
pub(crate) struct CellRows<'a> {
    words: &'a [u32],
    /// Words from a row to the next, and from a plane to the next.
    row: u32,
    plane: u32,
    /// The lowest cell, and the number of cells along each axis.
    low: [i32; 3],
    size: [u32; 3],
}

impl<'a> CellRows<'a> {
    pub fn words(&self) -> &'a [u32] {
        self.words
    }

    /// The word and the bit in it of cell `c`, and 1 if the cell is among them; 0 and the first word otherwise.
    #[inline(always)]
    pub fn place(&self, c: [i32; 3]) -> (u32, u32, u32) {
        let x = c[0].wrapping_sub(self.low[0]) as u32;
        let y = c[1].wrapping_sub(self.low[1]) as u32;
        let z = c[2].wrapping_sub(self.low[2]) as u32;
        let is_inside = u32::from((x < self.size[0]) & (y < self.size[1]) & (z < self.size[2]));
        let word = z.wrapping_mul(self.plane).wrapping_add(y.wrapping_mul(self.row)).wrapping_add(x >> 5);
        (word * is_inside, x & 31, is_inside)
    }

    /// Whether the bit of any cell is set in a box, given by its lowest and highest cells.
    pub fn any(&self, low: [i32; 3], high: [i32; 3]) -> bool {
        let within = |k: usize| {
            let last = (high[k] - self.low[k]).min(self.size[k] as i32 - 1);
            let first = (low[k] - self.low[k]).clamp(0, last.max(0));
            first as u32..(last + 1).max(first) as u32
        };
        let (x, y, z) = (within(0), within(1), within(2));
        if x.is_empty() {
            return false;
        }
        let (first, last) = (x.start, x.end - 1);
        z.flat_map(|z| y.clone().map(move |y| z * self.plane + y * self.row)).any(|row| {
            (first >> 5..=last >> 5).any(|word| {
                let from = if word == first >> 5 { u32::MAX << (first & 31) } else { u32::MAX };
                let to = if word == last >> 5 { u32::MAX >> (31 - (last & 31)) } else { u32::MAX };
                self.words[(row + word) as usize] & from & to != 0
            })
        })
    }

    /// Whether the bit of cell `c` is set.
    pub fn contains(&self, c: [i32; 3]) -> bool {
        let (word, bit, is_inside) = self.place(c);
        self.words[word as usize] >> bit & is_inside == 1
    }
}
