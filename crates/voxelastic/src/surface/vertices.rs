//! Where vertices are, and what they bear: from the names of a block's vertices, in their order.

use super::cells::Corner;
use super::crossings::Vertices;
use super::gaps::Closed;
use super::layout::{Around, CENTRE, Head};
use super::samples::coords;
use super::view::View;
use crate::dispatch::Kernel;
use crate::octree::voxel_index;

/// Intensity of a vertex whose voxel has none: mid grey. A map may have blocks with and without.
const GREY: u8 = 128;

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
        let mut next = 0;
        for (i, block) in self.blocks.iter().enumerate() {
            let rank = self.first + i;
            let (around, head) = (&self.closed.layout.around[rank], &self.closed.layout.heads[rank]);
            for (word, &bits) in block.words.iter().enumerate() {
                let mut left = bits;
                while left != 0 {
                    let bit = left.trailing_zeros() as usize;
                    left &= left - 1;
                    let place = place(word, bit);
                    self.positions[next] = if word < 24 {
                        position(self.closed, around, head, rank, place, word / 8, self.voxel)
                    } else {
                        let direction = word - 21;
                        between(self.closed, around, head, place, direction).map(|c| c * self.voxel)
                    };
                    self.scales[next] = head.scale;
                    let shade = match self.closed.measured_shade(rank, place) {
                        Some(shade) => shade,
                        None => shade_of_gap(self.view, head, place),
                    };
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

/// The crossing between the voxel at `place` and the next one along `axis`, in metres.
#[inline(always)]
fn position(closed: &Closed<'_>, around: &Around, head: &Head, rank: usize, place: usize, axis: usize, voxel: f32) -> [f32; 3] {
    let (n, c) = (head.edge(), coords(place));
    let step = 1 << (3 * axis);
    let (next, there) = if c[axis] + 1 < n {
        (rank, place + step)
    } else {
        let neighbour = CENTRE + [1, 3, 9][axis];
        if around.native >> neighbour & 1 == 0 {
            return between(closed, around, head, place, axis).map(|c| c * voxel);
        }
        (around.ranks[neighbour] as usize, place - (n - 1) * step)
    };
    let (a, b) = (closed.steps(rank, place), closed.steps(next, there));
    let mut at = [c[0] as f32 + 0.5, c[1] as f32 + 0.5, c[2] as f32 + 0.5];
    at[axis] += a / (a - b);
    let (origin, size) = (head.origin(), (1u32 << head.scale) as f32);
    [0, 1, 2].map(|k| (origin[k] as f32 + at[k] * size) * voxel)
}

/// The crossing between the voxel at `place` and its neighbour in `direction`, which may be larger, in finest voxels.
fn between(closed: &Closed<'_>, around: &Around, head: &Head, place: usize, direction: usize) -> [f32; 3] {
    let here = coords(place).map(|v| v as i32);
    let mut there = here;
    there[direction % 3] += if direction < 3 { 1 } else { -1 };
    let [p, q] = [here, there].map(|c| Corner::at(c, closed, around, head));
    let t = p.distance / (p.distance - q.distance);
    std::array::from_fn(|k| p.centre[k] + t * (q.centre[k] - p.centre[k]))
}

/// Intensity at a voxel that was not measured often enough but may have been hit, 0 if it is unknown.
fn shade_of_gap(view: &View<'_>, head: &Head, place: usize) -> u8 {
    view.shade(head.id, voxel_index(coords(place), head.scale.into())).unwrap_or(0)
}
