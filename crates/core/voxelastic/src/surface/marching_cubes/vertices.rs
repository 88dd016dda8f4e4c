//! Positions, scales and intensities of vertices.

use super::cells::Corner;
use super::mesh_part::BlockVertices;
use crate::octree::{voxel_index, voxels_at};
use crate::simd::Kernel;
use crate::surface::blocks::block_grid::{BlockHead, CENTRE, Neighbours};
use crate::surface::blocks::block_masks::{BlockDistances, coords};
use crate::surface::blocks::fill_holes::FilledField;
use crate::surface::blocks::resolved_blocks::ResolvedBlocks;

/// Intensity of a vertex whose voxel has none: mid grey.
pub(crate) const GREY: u8 = 128;

/// Computes the vertices of a part's blocks.
pub(crate) struct PlaceVertices<'a> {
    pub filled: &'a FilledField<'a>,
    pub resolved: &'a ResolvedBlocks<'a>,
    /// Edge of a finest voxel in metres.
    pub voxel: f32,
    /// Rank of the first block.
    pub first: usize,
    pub blocks: &'a [BlockVertices],
    pub positions: &'a mut [[f32; 3]],
    pub scales: &'a mut [u8],
    pub intensities: &'a mut [u8],
    /// Whether any vertex has an intensity.
    pub has_intensity: &'a mut bool,
}

impl Kernel for PlaceVertices<'_> {
    #[inline(always)]
    fn run(self) {
        let mut intensities = [0; voxels_at(0)];
        let mut next = 0;
        for (i, block) in self.blocks.iter().enumerate() {
            let count = block.count() as usize;
            if count == 0 {
                continue;
            }
            let owner = Owner::new(self.filled, self.first + i, self.voxel);
            let head = owner.head;
            let has_intensity = self.resolved.copy_intensities(head.id, &mut intensities);
            self.scales[next..next + count].fill(head.scale);
            for (word, &bits) in block.words.iter().enumerate() {
                let mut left = bits;
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let mask_index = mask_index(word, bit);
                    self.positions[next] = if word < 24 { owner.crossing(mask_index, word / 8) } else { owner.between(mask_index, word - 21) };
                    let intensity = if has_intensity { intensities[voxel_index(coords(mask_index), head.scale.into()) % voxels_at(0)] } else { 0 };
                    *self.has_intensity |= intensity > 0;
                    self.intensities[next] = if intensity > 0 { intensity } else { GREY };
                    next += 1;
                }
            }
        }
    }
}

/// Mask index of the voxel that owns a vertex.
#[inline(always)]
pub(crate) fn mask_index(word: usize, bit: usize) -> usize {
    match word {
        24 => (bit & 7) << 3 | (bit >> 3) << 6,
        25 => bit & 7 | (bit >> 3) << 6,
        26 => bit,
        _ => (word % 8) << 6 | bit,
    }
}

/// A block that owns vertices.
struct Owner<'a> {
    filled: &'a FilledField<'a>,
    rank: usize,
    head: &'a BlockHead,
    neighbours: &'a Neighbours,
    measured: BlockDistances<'a>,
    origin: [i32; 3],
    /// Edge of a finest voxel in metres.
    voxel: f32,
}

impl<'a> Owner<'a> {
    #[inline(always)]
    fn new(filled: &'a FilledField<'a>, rank: usize, voxel: f32) -> Self {
        let (head, neighbours) = (&filled.grid.heads[rank], &filled.grid.neighbours[rank]);
        Self { filled, rank, head, neighbours, measured: filled.measured(rank), origin: head.origin(), voxel }
    }

    /// The crossing between the voxel with `mask_index` and the next one along `axis`, metres.
    #[inline(always)]
    fn crossing(&self, mask_index: usize, axis: usize) -> [f32; 3] {
        let (n, c, step) = (self.head.edge(), coords(mask_index), 1 << (3 * axis));
        let a = self.filled.steps_in(self.measured, self.rank, mask_index);
        let b = if c[axis] + 1 < n {
            self.filled.steps_in(self.measured, self.rank, mask_index + step)
        } else {
            let neighbour = CENTRE + [1, 3, 9][axis];
            if self.neighbours.native >> neighbour & 1 == 0 {
                return self.between(mask_index, axis);
            }
            self.filled.steps(self.neighbours.ranks[neighbour] as usize, mask_index - (n - 1) * step)
        };
        let mut at = [c[0] as f32 + 0.5, c[1] as f32 + 0.5, c[2] as f32 + 0.5];
        at[axis] += a / (a - b);
        let size = (1u32 << self.head.scale) as f32;
        let mut position = [0.0; 3];
        for k in 0..3 {
            position[k] = (self.origin[k] as f32 + at[k] * size) * self.voxel;
        }
        position
    }

    /// The crossing between the voxel with `mask_index` and its neighbour in `direction`, which may be larger, metres.
    fn between(&self, mask_index: usize, direction: usize) -> [f32; 3] {
        let here = coords(mask_index).map(|v| v as i32);
        let mut there = here;
        there[direction % 3] += if direction < 3 { 1 } else { -1 };
        let [p, q] = [here, there].map(|c| Corner::at(c, self.filled, self.neighbours, self.head));
        let t = p.distance / (p.distance - q.distance);
        std::array::from_fn(|k| (p.centre[k] + t * (q.centre[k] - p.centre[k])) * self.voxel)
    }
}
