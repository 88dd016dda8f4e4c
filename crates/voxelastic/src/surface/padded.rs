//! A block with a rim of its neighbours' voxels: all that its part of a mesh depends on.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::unpacked::Unpacked;
use super::view::View;
use crate::dispatch::{Kernel, dispatch};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel};
use crate::octree::{BLOCK_EDGE, Cursor, NONE, block_coords, block_key, edge_at, voxel_coords, voxel_index};

/// A voxel, by block and index in its array as the view sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Corner {
    /// Which of the 27 blocks around (13 is the block itself).
    pub neighbour: u8,
    /// Index in that block's array.
    pub voxel: u16,
}

/// The block itself among the 27.
pub(super) const CENTRE: usize = 13;
/// Width of the rim in voxels: one for the cells that the block may own, and one more for what closes gaps in the first.
const RIM: usize = 2;
/// Samples along an edge of the block with its rim.
const WIDTH: usize = BLOCK_EDGE + 2 * RIM;
/// Samples from row to row: a vector's worth.
pub(super) const ROW: usize = 16;
/// Rows of samples, and from one at z to the one at z + 1.
pub(super) const ROWS: usize = WIDTH * WIDTH;
pub(super) const LAYER: usize = WIDTH;

/// The samples around one block: its own voxels and a rim. Coordinates count voxels of the block's scale from its corner.
///
/// Rows of samples along x have masks; bit x + 2 stands for the sample at x.
pub(super) struct Padded {
    /// Ids of the 27 blocks, x fastest; [`NONE`] where there is none.
    pub ids: [u32; 27],
    /// Their scales; 0 where there is none.
    pub scales: [u8; 27],
    /// The block's scale and its edge in voxels of that scale.
    pub scale: usize,
    pub edge: usize,
    /// Whether all blocks around that exist have the block's scale.
    pub uniform: bool,
    /// Smallest corner of the block in finest voxels.
    pub origin: [i32; 3],
    /// Distances in finest voxels; NaN where unobserved, infinite where the neighbour is finer.
    pub distances: [f32; ROWS * ROW],
    /// Samples that were observed (or bridged), by row.
    pub known: [u16; ROWS],
    /// Samples behind the surface, by row.
    pub behind: [u16; ROWS],
}

impl Padded {
    pub fn new() -> Self {
        Self {
            ids: [NONE; 27],
            scales: [0; 27],
            scale: 0,
            edge: 0,
            uniform: true,
            origin: [0; 3],
            distances: [f32::NAN; ROWS * ROW],
            known: [0; ROWS],
            behind: [0; ROWS],
        }
    }

    /// Index of the row of samples at `y` and `z`.
    #[inline(always)]
    pub fn row(y: i32, z: i32) -> usize {
        (y + RIM as i32) as usize + (z + RIM as i32) as usize * LAYER
    }

    /// Index of the sample at voxel `c`.
    #[inline(always)]
    pub fn at(c: [i32; 3]) -> usize {
        (c[0] + RIM as i32) as usize + Self::row(c[1], c[2]) * ROW
    }

    /// The bit that stands for the sample at `x` in the mask of its row.
    #[inline(always)]
    pub fn bit(x: i32) -> u32 {
        (x + RIM as i32) as u32
    }

    /// How far the samples reach beyond the block: a block of one voxel has no second ring of neighbours.
    #[inline(always)]
    pub fn reach(&self) -> i32 {
        RIM.min(self.edge) as i32
    }

    /// Which of the 27 blocks voxel `c` lies in.
    #[inline(always)]
    pub fn neighbour(&self, c: [i32; 3]) -> usize {
        self.side(c[0]) + 3 * self.side(c[1]) + 9 * self.side(c[2])
    }

    /// The voxel at `c`, which must not lie in a finer block.
    #[inline(always)]
    pub fn corner(&self, c: [i32; 3]) -> Corner {
        let neighbour = self.neighbour(c);
        let scale = usize::from(self.scales[neighbour]);
        let mask = self.edge as i32 - 1;
        let local = |v: i32| (v & mask) as usize >> (scale - self.scale);
        Corner { neighbour: neighbour as u8, voxel: voxel_index([local(c[0]), local(c[1]), local(c[2])], scale) as u16 }
    }

    /// Centre of a voxel in finest voxels, submap frame.
    pub fn position(&self, corner: Corner) -> [f32; 3] {
        let scale = usize::from(self.scales[usize::from(corner.neighbour)]);
        let c = voxel_coords(usize::from(corner.voxel), scale);
        let offset = neighbour_offset(usize::from(corner.neighbour));
        std::array::from_fn(|k| (self.origin[k] + offset[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * (1 << scale) as f32)
    }

    /// Whether the surface passes between two observed samples.
    #[inline(always)]
    pub fn crosses(&self, a: usize, b: usize) -> bool {
        let (a, b) = (self.distances[a], self.distances[b]);
        // Comparisons with NaN are false, and infinity is no distance.
        (a < 0.0 && (0.0..f32::INFINITY).contains(&b)) || (b < 0.0 && (0.0..f32::INFINITY).contains(&a))
    }

    /// The zero crossing between the voxels at `a` and `b`, in finest voxels, submap frame.
    pub fn between(&self, a: [i32; 3], b: [i32; 3]) -> [f32; 3] {
        let (p, q) = (self.position(self.corner(a)), self.position(self.corner(b)));
        let (da, db) = (self.distances[Self::at(a)], self.distances[Self::at(b)]);
        let t = da / (da - db);
        std::array::from_fn(|k| p[k] + t * (q[k] - p[k]))
    }

    /// Finds the blocks around block `id`. Returns false when no surface can pass: `sides` says for each block on which sides
    /// of a surface it has voxels.
    pub fn enter(&mut self, view: &View<'_>, sides: &[u8], cursor: &mut Cursor, id: u32) -> bool {
        let coords = block_coords(view.field.block(id).key);
        self.scale = view.scale(id);
        self.edge = edge_at(self.scale);
        self.origin = coords.map(|c| c * BLOCK_EDGE as i32);
        self.uniform = true;
        let mut around = 0;
        for i in 0..27 {
            let offset = neighbour_offset(i);
            let key = block_key(std::array::from_fn(|k| coords[k] + offset[k]));
            let neighbour = if i == CENTRE { id } else { cursor.block(view.field.tree(), key).unwrap_or(NONE) };
            self.ids[i] = neighbour;
            self.scales[i] = 0;
            if neighbour != NONE {
                self.scales[i] = view.scale(neighbour) as u8;
                self.uniform &= usize::from(self.scales[i]) == self.scale;
                around |= sides[neighbour as usize];
            }
        }
        around == IN_FRONT | BEHIND
    }

    /// Loads the samples: voxels of at least `min_weight` count as observed.
    pub fn load(&mut self, view: &View<'_>, unpacked: &mut Unpacked, min_weight: u16) {
        self.ids.iter().filter(|id| **id != NONE).for_each(|&id| unpacked.hold(view, id));
        let voxels = self.ids.map(|id| if id == NONE { &[][..] } else { unpacked.voxels(view, id) });
        dispatch(Load { padded: self, voxels, min_weight });
    }

    /// Masks over the rows of the samples whose block, one of the 27, is `wanted`: by the row's side in y and z, 0 before the
    /// block, 1 in it, 2 beyond.
    pub fn rows_of_blocks(&self, wanted: impl Fn(usize) -> bool) -> [[u16; 3]; 3] {
        let parts = [0b11, ((1 << self.edge) - 1) << RIM, 0b11 << (self.edge + RIM)];
        [0, 1, 2].map(|z| [0, 1, 2].map(|y| (0..3).filter(|x| wanted(x + 3 * y + 9 * z)).fold(0, |mask, x| mask | parts[x])))
    }

    /// The side of coordinate `v`: 0 before the block, 1 in it, 2 beyond.
    #[inline(always)]
    pub fn side(&self, v: i32) -> usize {
        usize::from(v >= 0) + usize::from(v >= self.edge as i32)
    }
}

/// Loads a block with its rim.
struct Load<'a> {
    padded: &'a mut Padded,
    voxels: [&'a [Voxel]; 27],
    min_weight: u16,
}

impl Kernel for Load<'_> {
    #[inline(always)]
    fn run(mut self) {
        if self.padded.uniform {
            self.uniform();
        } else {
            self.mixed();
        }
        self.masks();
    }
}

impl Load<'_> {
    /// Copies voxels row by row, then turns all of them into distances at once.
    #[inline(always)]
    fn uniform(&mut self) {
        let Self { padded, voxels, min_weight } = self;
        let mut copies = [Voxel::default(); ROWS * ROW];
        let (n, reach) = (padded.edge, padded.reach() as usize);
        let layout = [(-(reach as i32), reach), (0, n), (n as i32, reach)];
        for (side_z, (z0, depth)) in layout.into_iter().enumerate() {
            for (side_y, (y0, height)) in layout.into_iter().enumerate() {
                for (side_x, (x0, width)) in layout.into_iter().enumerate() {
                    let voxels = voxels[side_x + 3 * side_y + 9 * side_z];
                    if voxels.is_empty() {
                        continue;
                    }
                    // Voxels before the block are the last ones of their block.
                    let first = [(x0, width), (y0, height), (z0, depth)].map(|(low, width)| if low < 0 { n - width } else { 0 });
                    for z in 0..depth {
                        for y in 0..height {
                            let to = Padded::at([x0, y0 + y as i32, z0 + z as i32]);
                            let from = voxel_index([first[0], first[1] + y, first[2] + z], padded.scale);
                            copies[to..to + width].copy_from_slice(&voxels[from..from + width]);
                        }
                    }
                }
            }
        }
        let unit = (1 << padded.scale) as f32 / DISTANCE_STEPS;
        for i in 0..ROWS * ROW {
            padded.distances[i] = distance(copies[i], unit, *min_weight);
        }
    }

    /// Looks samples up in blocks of different scales, those of a row in one block together.
    #[inline(always)]
    fn mixed(&mut self) {
        let (n, reach) = (self.padded.edge as i32, self.padded.reach());
        for z in -reach..n + reach {
            for y in -reach..n + reach {
                for (x, width) in [(-reach, reach), (0, n), (n, reach)] {
                    self.part([x, y, z], width as usize);
                }
            }
        }
    }

    /// Loads `width` samples from `c` on along x; they lie in one block.
    #[inline(always)]
    fn part(&mut self, c: [i32; 3], width: usize) {
        let Self { padded, voxels, min_weight } = self;
        let neighbour = padded.neighbour(c);
        let coarser = usize::from(padded.scales[neighbour]).checked_sub(padded.scale);
        let [x, y, z] = c.map(|v| (v & (padded.edge as i32 - 1)) as usize);
        let samples = &mut padded.distances[Padded::at(c)..][..width];
        match coarser {
            _ if padded.ids[neighbour] == NONE => samples.fill(f32::NAN),
            None => samples.fill(f32::INFINITY),
            Some(coarser) => {
                let scale = padded.scale + coarser;
                let unit = (1 << scale) as f32 / DISTANCE_STEPS;
                let row = &voxels[neighbour][voxel_index([0, y >> coarser, z >> coarser], scale)..];
                for i in 0..width {
                    samples[i] = distance(row[(x + i) >> coarser], unit, *min_weight);
                }
            }
        }
    }

    /// Notes for each row which samples are known and which are behind the surface.
    #[inline(always)]
    fn masks(&mut self) {
        let Padded { distances, known, behind, .. } = &mut *self.padded;
        let mut flags = [[0u8; ROWS * ROW]; 2];
        for i in 0..ROWS * ROW {
            // Not `< INFINITY`, which becomes a comparison that valgrind 3.19 takes for true of NaN.
            flags[0][i] = u8::from(distances[i].abs() <= f32::MAX);
            flags[1][i] = u8::from(distances[i] < 0.0);
        }
        (*known, *behind) = ([0; ROWS], [0; ROWS]);
        let (n, reach) = (self.padded.edge as i32, self.padded.reach());
        let used = ((1u32 << Padded::bit(n + reach)) - (1 << Padded::bit(-reach))) as u16;
        for z in -reach..n + reach {
            for row in Padded::row(-reach, z)..Padded::row(n + reach, z) {
                self.padded.known[row] = used & pack(&flags[0][row * ROW..][..ROW]);
                self.padded.behind[row] = used & pack(&flags[1][row * ROW..][..ROW]);
            }
        }
    }
}

/// Sixteen bytes, each 0 or 1, as bits.
#[inline(always)]
fn pack(bytes: &[u8]) -> u16 {
    // The product adds byte k, shifted to bit k, into the topmost byte; nothing else reaches it.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let eight = |bytes: &[u8]| bytes.iter().rev().fold(0u64, |word, &b| word << 8 | u64::from(b)).wrapping_mul(GATHER) >> 56;
    (eight(&bytes[..8]) | eight(&bytes[8..16]) << 8) as u16
}

/// Distance of an observed voxel in finest voxels, NaN for others.
#[inline(always)]
fn distance(voxel: Voxel, unit: f32, min_weight: u16) -> f32 {
    let distance = f32::from(voxel.distance) * unit;
    if voxel.weight >= min_weight { distance } else { f32::NAN }
}

/// Offset in blocks of neighbour `i` of 27.
#[inline(always)]
pub(super) fn neighbour_offset(i: usize) -> [i32; 3] {
    [(i % 3) as i32 - 1, (i / 3 % 3) as i32 - 1, (i / 9) as i32 - 1]
}

/// A block has observed voxels in front of a surface ...
const IN_FRONT: u8 = 1;
/// ... or behind one.
const BEHIND: u8 = 2;

/// On which sides of a surface `voxels` lie.
pub(super) fn sides(voxels: &[Voxel], min_weight: u16) -> u8 {
    let (mut front, mut behind) = (false, false);
    for v in voxels {
        let observed = v.weight >= min_weight;
        front |= observed & (v.distance >= 0);
        behind |= observed & (v.distance < 0);
    }
    (u8::from(front) * IN_FRONT) | (u8::from(behind) * BEHIND)
}
