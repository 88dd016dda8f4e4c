//! What a mesh needs of a block's voxels: bit masks of where they are known and on which side, and the distances of the known ones.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use super::layout::{Layout, PART, part_of};
use super::view::View;
use crate::dispatch::{Kernel, dispatch};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel, VoxelBuffer};
use crate::octree::{edge_at, voxels_at};
use bytemuck::Zeroable;
use rayon::prelude::*;

/// A bit per voxel of a block: bit x + 8 y of layer z, whatever the block's scale. The bit's number over all layers is the voxel's *place*.
pub(super) type Bits = [u64; 8];

/// The bits of a layer that a block with an edge of `n` voxels has.
#[inline(always)]
pub(super) fn valid(n: usize) -> u64 {
    (u64::MAX >> (64 - 8 * n)) & (0x0101_0101_0101_0101 * ((1 << n) - 1))
}

/// The place of a voxel.
#[inline(always)]
pub(super) fn place(c: [usize; 3]) -> usize {
    c[0] | c[1] << 3 | c[2] << 6
}

/// The voxel at a place.
#[inline(always)]
pub(super) fn coords(place: usize) -> [usize; 3] {
    [place & 7, place >> 3 & 7, place >> 6]
}

/// How many bits of `bits` are set before `bit`.
#[inline(always)]
pub(super) fn rank(bits: u64, bit: usize) -> usize {
    (bits & ((1 << bit) - 1)).count_ones() as usize
}

/// A distance between neighbouring voxels that changes faster than this many times their spacing is no surface, but the
/// place where the band in front of one surface meets the band behind another.
pub(super) const MAX_SLOPE: f32 = 4.0;
/// Only between voxels of which one is farther away than this does a distance change that fast, in steps.
pub(super) const FAR: u16 = (MAX_SLOPE / 2.0 * DISTANCE_STEPS) as u16;

/// The voxels of a block that count.
#[derive(Clone, Copy, Zeroable)]
pub(super) struct Samples {
    /// Those that were observed often enough, or lie in gaps that were closed.
    pub known: Bits,
    /// Those of them behind the surface.
    pub behind: Bits,
    /// Those of them that are farther from it than [`FAR`].
    pub far: Bits,
    /// Where the values that go with them begin in the part's list, and how many there are before those of each layer.
    pub start: u32,
    pub before: [u16; 8],
}

impl Samples {
    pub const EMPTY: Self = Self { known: [0; 8], behind: [0; 8], far: [0; 8], start: 0, before: [0; 8] };
}

/// What was measured at the known voxels of a part's blocks, block by block and place by place.
#[derive(Default)]
pub(super) struct Measured {
    /// In steps of the block's scale.
    distances: Vec<i16>,
    /// Intensities, 0 where unknown; nothing from the end of the list on.
    shades: Vec<u8>,
}

/// The measured voxels of all blocks, by rank, and their values by part.
pub(super) struct Field {
    pub blocks: Vec<Samples>,
    measured: Vec<Measured>,
}

impl Field {
    /// Takes from all blocks the voxels of at least `min_weight`.
    pub fn take(view: &View<'_>, layout: &Layout, min_weight: u16) -> Self {
        let mut blocks: Vec<Samples> = bytemuck::allocation::zeroed_vec(layout.heads.len());
        let parts = blocks.par_chunks_mut(PART).zip(layout.heads.par_chunks(PART));
        let measured = parts.map(|(blocks, heads)| {
            let mut taker = Taker::new(min_weight);
            for (samples, head) in blocks.iter_mut().zip(heads) {
                view.copy(head.id, &mut taker.voxels);
                taker.shaded = view.copy_shades(head.id, &mut taker.shades);
                dispatch(Take { taker: &mut taker, samples, scale: head.scale.into() });
            }
            taker.measured
        });
        let measured = measured.collect();
        Self { blocks, measured }
    }

    /// Distance of the voxel at `place` in block `rank`, in steps of its scale; none where nothing was measured.
    #[inline(always)]
    pub fn steps(&self, rank: usize, place: usize) -> Option<i16> {
        let index = self.index(rank, place)?;
        Some(self.measured[part_of(rank)].distances[index])
    }

    /// Intensity of the voxel at `place` in block `rank`, 0 where it is unknown; none where nothing was measured.
    #[inline(always)]
    pub fn shade(&self, rank: usize, place: usize) -> Option<u8> {
        let index = self.index(rank, place)?;
        Some(self.measured[part_of(rank)].shades.get(index).copied().unwrap_or(0))
    }

    /// Where the voxel is in the lists of its part.
    #[inline(always)]
    fn index(&self, rank: usize, place: usize) -> Option<usize> {
        let samples = &self.blocks[rank];
        let (layer, bit) = (place >> 6, place & 63);
        let known = samples.known[layer];
        (known >> bit & 1 == 1).then(|| samples.start as usize + usize::from(samples.before[layer]) + self::rank(known, bit))
    }
}

/// Takes blocks one by one.
struct Taker {
    min_weight: u16,
    /// The block's voxels and intensities.
    voxels: Box<VoxelBuffer>,
    shades: Box<[u8; voxels_at(0)]>,
    shaded: bool,
    measured: Measured,
}

impl Taker {
    fn new(min_weight: u16) -> Self {
        Self {
            min_weight,
            voxels: bytemuck::allocation::zeroed_box(),
            shades: bytemuck::allocation::zeroed_box(),
            shaded: false,
            measured: Measured::default(),
        }
    }
}

struct Take<'a> {
    taker: &'a mut Taker,
    samples: &'a mut Samples,
    scale: usize,
}

impl Kernel for Take<'_> {
    #[inline(always)]
    fn run(self) {
        let Taker { min_weight, voxels, shades, shaded, measured } = self.taker;
        let n = edge_at(self.scale);
        if n < 8 {
            spread(&mut voxels[..], n, Voxel::default());
            spread(&mut shades[..], n, 0);
        }
        // A bit for each of known, behind and far.
        let mut flags = [0u8; voxels_at(0)];
        for i in 0..voxels_at(0) {
            let Voxel { distance, weight } = voxels[i];
            let known = weight >= *min_weight;
            flags[i] = u8::from(known) | u8::from(known & (distance < 0)) << 1 | u8::from(known & (distance.unsigned_abs() > FAR)) << 2;
        }
        let (mut distances, mut known_shades, mut count) = ([0i16; voxels_at(0)], [0u8; voxels_at(0)], 0);
        self.samples.start = measured.distances.len() as u32;
        for z in 0..n {
            let [mut known, mut behind, mut far] = [0; 3];
            for y in 0..8 {
                let mut row = 0;
                for x in 0..8 {
                    row |= u64::from(flags[64 * z + 8 * y + x]) << (8 * x);
                }
                known |= gather(row) << (8 * y);
                behind |= gather(row >> 1) << (8 * y);
                far |= gather(row >> 2) << (8 * y);
            }
            (self.samples.known[z], self.samples.behind[z], self.samples.far[z]) = (known, behind, far);
            self.samples.before[z] = count as u16;
            let mut left = known;
            while left != 0 {
                let place = 64 * z + left.trailing_zeros() as usize;
                distances[count % voxels_at(0)] = voxels[place % voxels_at(0)].distance;
                known_shades[count % voxels_at(0)] = shades[place % voxels_at(0)];
                count += 1;
                left &= left - 1;
            }
        }
        if *shaded {
            measured.shades.resize(measured.distances.len(), 0);
            measured.shades.extend_from_slice(&known_shades[..count]);
        }
        measured.distances.extend_from_slice(&distances[..count]);
    }
}

/// The lowest bits of eight bytes.
#[inline(always)]
fn gather(bytes: u64) -> u64 {
    // The product adds byte k, shifted to bit k, into the topmost byte; nothing else reaches it.
    (bytes & 0x0101_0101_0101_0101).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// Moves the items of an array with an edge of `n`, the first ones of `items`, to their places.
#[inline(always)]
fn spread<T: Copy>(items: &mut [T], n: usize, empty: T) {
    // From the last row on: a row moves to the right, onto what has moved already.
    for z in (0..8).rev() {
        for y in (0..8).rev() {
            for x in (0..8).rev() {
                let inside = x < n && y < n && z < n;
                items[x + 8 * y + 64 * z] = if inside { items[x + n * (y + n * z)] } else { empty };
            }
        }
    }
}
