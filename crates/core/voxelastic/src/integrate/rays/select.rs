//! Selection: the blocks that each ray passes within its reach, grouped by block in Morton order.

use super::dda::LANES;
use super::ray::Ray;
use crate::geometry::{morton, sort_by_bits};
use crate::octree::{BLOCK_EDGE, block_key};
use crate::simd::floor_positive;
use crate::simd::larger;
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Bits of a record that hold the number of the ray.
const RAY_BITS: u32 = 24;
/// Most rays of one scan.
pub(crate) const MAX_RAYS: usize = 1 << RAY_BITS;
/// Largest coordinate of a key.
const MAX_COORD: u32 = (1 << 21) - 1;
/// Most bits of a block coordinate that fit a record.
const MAX_AXIS_BITS: u32 = (u64::BITS - RAY_BITS) / 3;

/// The number of the ray in a record.
#[inline(always)]
pub(crate) fn ray_of(record: u64) -> usize {
    record as usize & (MAX_RAYS - 1)
}

/// The rays of one block: `records[start..end]`, in ray order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockRays {
    pub key: u64,
    pub start: u32,
    pub end: u32,
}

/// Scratch space and result of a selection, reused from scan to scan.
#[derive(Clone, Debug, Default)]
pub(crate) struct Selection {
    /// (block, ray) pairs, block in the upper bits.
    pub records: Vec<u64>,
    pub blocks: Vec<BlockRays>,
    spare: Vec<u64>,
    /// First record of each run of records with the same block.
    starts: Vec<u32>,
    /// Bits of each block coordinate, wrapped to the window, spread to every third bit as in a key.
    spread: Vec<u64>,
    chunks: Vec<Vec<u64>>,
}

/// A cube of blocks around the sensor to which block coordinates are wrapped, each spread over every third bit. Subtracting the mask of these bits adds one to
/// a spread coordinate, because borrows run through the bits between them; subtracting one takes one away.
#[derive(Clone, Copy)]
struct Window {
    bits: u32,
    mask: u64,
}

impl Window {
    fn new(reach: u32) -> Self {
        let bits = (2 * reach + 1).next_power_of_two().ilog2().max(1);
        debug_assert!(bits <= MAX_AXIS_BITS);
        let mask = (0..bits).fold(0u64, |m, b| m | 1 << (3 * b));
        Self { bits, mask }
    }

    /// Blocks along an edge, a power of two.
    fn size(self) -> usize {
        1 << self.bits
    }
}

/// Largest reach around the sensor, in blocks, that a selection can express.
pub(crate) const MAX_REACH: u32 = (1 << (MAX_AXIS_BITS - 1)) - 1;

impl Selection {
    /// Finds the blocks along each ray within its reach. `sensor` is the position of the sensor in finest voxels; no point within the reach of a ray may be
    /// farther from it than `reach` blocks.
    pub fn select(&mut self, rays: &[Ray], sensor: [f32; 3], reach: u32) {
        const CHUNK: usize = 4096;
        let window = Window::new(reach);
        let centre = sensor.map(|c| (c / BLOCK_EDGE as f32).floor() as i32);
        // Block coordinates relative to the corner of the window are never negative, so truncation is floor.
        let corner = centre.map(|c| c - reach as i32);
        if self.spread.len() != window.size() {
            self.spread = (0..window.size()).map(|c| block_key([c as i32, 0, 0]) & window.mask).collect();
        }
        self.chunks.resize(rays.len().div_ceil(CHUNK), Vec::new());
        let spread = &self.spread[..];
        self.chunks.par_iter_mut().zip(rays.par_chunks(CHUNK)).enumerate().for_each(|(chunk, (records, rays))| {
            records.clear();
            dispatch(CollectBlocks { rays, first: chunk * CHUNK, corner, window, spread, records });
        });
        self.records.clear();
        self.chunks.iter().for_each(|c| self.records.extend_from_slice(c));
        sort_by_bits(&mut self.records, &mut self.spare, RAY_BITS, RAY_BITS + 3 * window.bits);
        self.group(corner, window);
    }

    /// Cuts the sorted records into one run per block and recovers each block's full key.
    fn group(&mut self, corner: [i32; 3], window: Window) {
        let wrapped = |record: u64| record >> RAY_BITS;
        // Branch-free, because run lengths are unpredictable: every record is written as the start of a run, and overwritten by the next one if it is none.
        self.starts.resize(self.records.len() + 1, 0);
        let (mut count, mut last) = (0, u64::MAX);
        for (&record, i) in self.records.iter().zip(0..) {
            self.starts[count] = i;
            count += usize::from(wrapped(record) != last);
            last = wrapped(record);
        }
        self.starts[count] = self.records.len() as u32;
        let unwrapper = KeyUnwrapper::new(corner, window);
        let run = |ends: &[u32]| BlockRays { key: unwrapper.key(wrapped(self.records[ends[0] as usize])), start: ends[0], end: ends[1] };
        self.blocks.clear();
        self.blocks.extend(self.starts[..=count].windows(2).map(run));
    }
}

/// Recovers full keys from keys whose coordinates are wrapped to a window.
struct KeyUnwrapper {
    /// For each axis: the key bits within the window, those bits of the window's smallest corner, and the bits above them before and after the coordinate
    /// wraps.
    axes: [(u64, u64, [u64; 2]); 3],
}

impl KeyUnwrapper {
    fn new(corner: [i32; 3], window: Window) -> Self {
        let axis = |k: usize| {
            let mut ones = [0; 3];
            ones[k] = MAX_COORD;
            let (all, window_bits) = (morton::encode(ones), window.mask << k);
            let mut next = corner;
            next[k] += window.size() as i32;
            (window_bits, block_key(corner) & window_bits, [corner, next].map(|c| block_key(c) & all & !window_bits))
        };
        Self { axes: [0, 1, 2].map(axis) }
    }

    /// The first key from the window's smallest corner on whose low bits are `wrapped`. Spread bits of one axis compare like its coordinate.
    #[inline(always)]
    fn key(&self, wrapped: u64) -> u64 {
        self.axes.iter().fold(wrapped, |key, &(window_bits, corner, above)| key | above[usize::from(wrapped & window_bits < corner)])
    }
}

/// Appends a record for every block that a ray passes.
struct CollectBlocks<'a> {
    rays: &'a [Ray],
    /// Number of the first ray.
    first: usize,
    corner: [i32; 3],
    window: Window,
    /// See [`Selection::spread`].
    spread: &'a [u64],
    records: &'a mut Vec<u64>,
}

impl Kernel for CollectBlocks<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { rays, first, corner, window, spread, records } = self;
        // A power of two, so that no index needs a test.
        let spread = &spread[..window.size()];
        let last = spread.len() - 1;
        for (step, rays) in rays.chunks(LANES).enumerate() {
            let starts = RayStarts::new(rays, corner);
            for (lane, ray) in rays.iter().enumerate() {
                let mut next = [0, 1, 2].map(|k| starts.next[k][lane]);
                let between = [0, 1, 2].map(|k| starts.between[k][lane]);
                let mut at = [0, 1, 2].map(|k| spread[starts.block[k][lane] as usize & last]);
                // Subtracting the mask adds one to a spread coordinate, subtracting one takes one away, see [`Window`].
                let step_bits = ray.direction.map(|d| if d > 0.0 { window.mask } else { 1 });
                let index = (first + step * LANES + lane) as u64;
                let record = |at: &[u64; 3]| (at[0] | at[1] << 1 | at[2] << 2) << RAY_BITS | index;
                records.push(record(&at));
                for _ in 0..starts.crossings[lane] {
                    // By masks: which face comes next is unpredictable.
                    let x = next[0] <= next[1] && next[0] <= next[2];
                    let y = !x && next[1] <= next[2];
                    for (k, chosen) in [x, y, !(x || y)].into_iter().enumerate() {
                        next[k] += if chosen { between[k] } else { 0.0 };
                        at[k] = at[k].wrapping_sub(if chosen { step_bits[k] } else { 0 }) & window.mask;
                    }
                    records.push(record(&at));
                }
            }
        }
    }
}

/// Where sixteen rays start, one array an axis.
struct RayStarts {
    /// Parameter at which the next block boundary is crossed, and difference between two crossings.
    next: [[f32; LANES]; 3],
    between: [[f32; LANES]; 3],
    /// The first block.
    block: [[i32; LANES]; 3],
    /// Boundaries crossed until the ray ends.
    crossings: [u32; LANES],
}

impl RayStarts {
    #[inline(always)]
    fn new(rays: &[Ray], corner: [i32; 3]) -> Self {
        const PER_VOXEL: f32 = 1.0 / BLOCK_EDGE as f32;
        let (mut point, mut direction, mut reach) = ([[0f32; LANES]; 3], [[0f32; LANES]; 3], [[0f32; LANES]; 2]);
        for (lane, ray) in rays.iter().enumerate().take(LANES) {
            let edge = (1u32 << ray.scale) as f32 * PER_VOXEL;
            for k in 0..3 {
                (point[k][lane], direction[k][lane]) = (ray.point[k], ray.direction[k]);
            }
            (reach[0][lane], reach[1][lane]) = (ray.reach[0] * edge, ray.reach[1] * edge);
        }
        let mut starts = Self { next: [[0.0; LANES]; 3], between: [[0.0; LANES]; 3], block: [[0; LANES]; 3], crossings: [0; LANES] };
        for k in 0..3 {
            for lane in 0..LANES {
                let (point, direction) = (point[k][lane] * PER_VOXEL - corner[k] as f32, direction[k][lane]);
                let (from, to) = (point - direction * reach[0][lane], point + direction * reach[1][lane]);
                let (first, last) = (floor_positive(from), floor_positive(to));
                starts.crossings[lane] += (last - first).unsigned_abs();
                let inverse = 1.0 / larger(direction.abs(), 1e-9);
                let inside = from - first as f32;
                starts.next[k][lane] = if direction > 0.0 { 1.0 - inside } else { inside } * inverse;
                starts.between[k][lane] = inverse;
                starts.block[k][lane] = first + corner[k];
            }
        }
        starts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::block_coords;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Many samples of a ray within its reach, finest voxels.
    fn samples(ray: &Ray) -> impl Iterator<Item = [f32; 3]> {
        let [before, behind] = REACH;
        (0..=2000).map(move |s| {
            let t = (1 << ray.scale) as f32 * ((before + behind) * s as f32 / 2000.0 - before);
            std::array::from_fn(|k| ray.point[k] + t * ray.direction[k])
        })
    }

    /// Blocks that contain samples of the rays.
    fn sampled(rays: &[Ray]) -> BTreeMap<(u64, usize), f32> {
        let mut touched = BTreeMap::new();
        for (i, ray) in rays.iter().enumerate() {
            for at in samples(ray) {
                // Distance to the nearest block face, to tolerate rounding on the face itself.
                let edge = at.iter().map(|c| (c / 8.0 - (c / 8.0).round()).abs()).fold(f32::INFINITY, f32::min);
                let key = block_key(at.map(|c| (c / 8.0).floor() as i32));
                let best = touched.entry((key, i)).or_insert(0f32);
                *best = best.max(edge);
            }
        }
        touched
    }

    /// Whether a sample of the ray is in block `key` or on its faces, within rounding.
    fn reaches(ray: &Ray, key: u64) -> bool {
        let corner = block_coords(key).map(|c| (c * 8) as f32);
        samples(ray).any(|at| (0..3).all(|k| (corner[k] - 0.02..=corner[k] + 8.02).contains(&at[k])))
    }

    const REACH: [f32; 2] = [3.0, 2.0];

    fn ray(sensor: [f32; 3], direction: [f32; 3], range: f32, scale: u32) -> Ray {
        let length = direction.iter().map(|c| c * c).sum::<f32>().sqrt();
        let direction = direction.map(|c| c / length);
        Ray { point: std::array::from_fn(|k| sensor[k] + range * direction[k]), direction, scale, range, reach: REACH, ..Ray::default() }
    }

    /// Compares a selection with the blocks that samples of the rays lie in.
    fn check(rays: &[Ray], sensor: [f32; 3]) -> Result<(), TestCaseError> {
        let mut selection = Selection::default();
        selection.select(rays, sensor, 900 / 8 + 6);
        let mut selected = BTreeMap::new();
        for run in &selection.blocks {
            for &record in &selection.records[run.start as usize..run.end as usize] {
                prop_assert!(selected.insert((run.key, ray_of(record)), ()).is_none(), "a pair twice");
            }
        }
        let slow = sampled(rays);
        for (pair, depth) in &slow {
            prop_assert!(selected.contains_key(pair) || *depth < 2e-3, "missed {:?} depth {}", block_coords(pair.0), depth);
        }
        let extra = selected.keys().filter(|pair| !slow.contains_key(pair) && !reaches(&rays[pair.1], pair.0)).count();
        prop_assert!(extra * 50 <= selected.len() + 50, "{extra} of {} pairs contain no sample", selected.len());
        Ok(())
    }

    /// Rays along block faces: which of the two blocks is taken is a matter of rounding.
    #[test]
    fn rays_in_the_planes_of_block_faces_select_a_block_on_either_side() {
        let sensor = [16.0, -24.0, 8.0];
        let axes = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, -1.0]];
        let rays: Vec<Ray> = axes.iter().flat_map(|&d| [40.0, 64.0, 300.0].map(|range| ray(sensor, d, range, 3))).collect();
        check(&rays, sensor).unwrap();
    }

    proptest! {
        #[test]
        fn selects_the_blocks_that_contain_samples_of_the_ray(
            sensor in prop::array::uniform3(-3000f32..3000.0),
            rays in prop::collection::vec((prop::array::uniform3(-1f32..1.0), 5f32..900.0, 0u32..4), 1..20),
        ) {
            let long = rays.iter().filter(|(d, ..)| d.iter().any(|c| c.abs() > 0.01));
            let rays: Vec<Ray> = long.map(|&(d, range, scale)| ray(sensor, d, range, scale)).collect();
            check(&rays, sensor)?;
        }
    }
}
