//! Where vertices are, and what they bear: from the names of a block's vertices, in their order.

use super::cells::Corner;
use super::crossings::Vertices;
use super::gaps::Closed;
use super::layout::{Around, CENTRE, Head};
use super::samples::{Measured, coords};
use super::view::View;
use crate::dispatch::Kernel;
use crate::octree::{voxel_index, voxels_at};

/// Intensity of a vertex whose voxel has none: mid grey. A map may have blocks with and without.
pub(super) const GREY: u8 = 128;

/// Places the vertices of a part's blocks.
pub(super) struct PlaceAll<'a> {
    pub closed: &'a Closed<'a>,
    pub view: &'a View<'a>,
    /// Edge of a finest voxel in metres.
    pub voxel: f32,
    /// Rank of the first block.
    pub first: usize,
    pub blocks: &'a [Vertices],
    pub positions: &'a mut [[f32; 3]],
    pub scales: &'a mut [u8],
    pub shades: &'a mut [u8],
    /// Whether any vertex has an intensity.
    pub shaded: &'a mut bool,
}

impl Kernel for PlaceAll<'_> {
    #[inline(always)]
    fn run(self) {
        let mut shades = [0; voxels_at(0)];
        let mut next = 0;
        for (i, block) in self.blocks.iter().enumerate() {
            let count = block.count() as usize;
            if count == 0 {
                continue;
            }
            let owner = Owner::new(self.closed, self.first + i, self.voxel);
            let head = owner.head;
            let shaded = self.view.copy_shades(head.id, &mut shades);
            self.scales[next..next + count].fill(head.scale);
            for (word, &bits) in block.words.iter().enumerate() {
                let mut left = bits;
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let place = place(word, bit);
                    self.positions[next] = if word < 24 { owner.crossing(place, word / 8) } else { owner.between(place, word - 21) };
                    let shade = if shaded { shades[voxel_index(coords(place), head.scale.into()) % voxels_at(0)] } else { 0 };
                    *self.shaded |= shade > 0;
                    self.shades[next] = if shade > 0 { shade } else { GREY };
                    next += 1;
                }
            }
        }
    }
}

/// The place of the voxel that a vertex belongs to.
#[inline(always)]
fn place(word: usize, bit: usize) -> usize {
    match word {
        24 => (bit & 7) << 3 | (bit >> 3) << 6,
        25 => bit & 7 | (bit >> 3) << 6,
        26 => bit,
        _ => (word % 8) << 6 | bit,
    }
}

/// A block that owns vertices.
struct Owner<'a> {
    closed: &'a Closed<'a>,
    rank: usize,
    head: &'a Head,
    around: &'a Around,
    measured: Measured<'a>,
    origin: [i32; 3],
    /// Edge of a finest voxel in metres.
    voxel: f32,
}

impl<'a> Owner<'a> {
    #[inline(always)]
    fn new(closed: &'a Closed<'a>, rank: usize, voxel: f32) -> Self {
        let (head, around) = (&closed.layout.heads[rank], &closed.layout.around[rank]);
        Self { closed, rank, head, around, measured: closed.measured(rank), origin: head.origin(), voxel }
    }

    /// The crossing between the voxel at `place` and the next one along `axis`, in metres.
    #[inline(always)]
    fn crossing(&self, place: usize, axis: usize) -> [f32; 3] {
        let (n, c, step) = (self.head.edge(), coords(place), 1 << (3 * axis));
        let a = self.closed.steps_in(self.measured, self.rank, place);
        let b = if c[axis] + 1 < n {
            self.closed.steps_in(self.measured, self.rank, place + step)
        } else {
            let neighbour = CENTRE + [1, 3, 9][axis];
            if self.around.native >> neighbour & 1 == 0 {
                return self.between(place, axis);
            }
            self.closed.steps(self.around.ranks[neighbour] as usize, place - (n - 1) * step)
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

    /// The crossing between the voxel at `place` and its neighbour in `direction`, which may be larger, in metres.
    fn between(&self, place: usize, direction: usize) -> [f32; 3] {
        let here = coords(place).map(|v| v as i32);
        let mut there = here;
        there[direction % 3] += if direction < 3 { 1 } else { -1 };
        let [p, q] = [here, there].map(|c| Corner::at(c, self.closed, self.around, self.head));
        let t = p.distance / (p.distance - q.distance);
        std::array::from_fn(|k| (p.centre[k] + t * (q.centre[k] - p.centre[k])) * self.voxel)
    }
}
