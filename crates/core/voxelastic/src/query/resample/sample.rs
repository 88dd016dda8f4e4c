//! The values of all submaps at points of a region of the grid.

use super::grid::{Affine, Region, Resampler};
use super::region::ValueRange;
use crate::field::occupancy::{BlockBox, OccupancyField, UNKNOWN};
use crate::geometry::morton;
use crate::octree::{BLOCK_SHIFT, NONE, voxel_index};
use crate::simd::{Kernel, dispatch};

/// Most points along an edge of a brick.
const BRICK: usize = 32;

/// Points that are looked up together, one vector lane each.
const LANES: usize = 8;

/// The values of a region of the map at points of the grid.
pub(super) struct Samples {
    /// Points along an edge of a smallest cube, and of the region.
    per_cube: usize,
    per_region: usize,
    /// [Union](super::super::atlas::union) of the submaps at each point, x fastest.
    values: Vec<i8>,
}

impl Samples {
    /// Samples a region. `occupied` of its smallest cubes are known to be occupied: if only states matter, others may not be looked up there.
    pub fn new(resampler: &Resampler, region: &Region<'_, '_>, occupied: &[(u64, i8)]) -> Self {
        let per_cube = resampler.samples;
        let per_region = per_cube << region.level;
        let mut samples = Self { per_cube, per_region, values: vec![UNKNOWN; per_region.pow(3)] };
        if resampler.to.states_only {
            for &(key, value) in occupied {
                samples.points(local(region, key)).for_each(|at| samples.values[at] = value);
            }
        }
        let grids: Vec<(&OccupancyField, Affine)> =
            region.submaps.iter().map(|submap| (submap.query.field, resampler.grid_of(region, submap).scaled(1.0 / per_cube as f64))).collect();
        let mut box_of_values = ValueBox::default();
        let bricks = per_region.div_ceil(BRICK);
        for i in 0..bricks.pow(3) {
            let low = [i % bricks, i / bricks % bricks, i / (bricks * bricks)].map(|c| c * BRICK);
            samples.add(low, low.map(|c| (c + BRICK).min(per_region)), &grids, resampler.to.states_only, &mut box_of_values);
        }
        samples
    }

    /// Adds all submaps to the points from `low` to before `high`.
    fn add(&mut self, low: [usize; 3], high: [usize; 3], grids: &[(&OccupancyField, Affine)], states_only: bool, window: &mut ValueBox) {
        let size: [f64; 3] = std::array::from_fn(|k| (high[k] - low[k]) as f64);
        let around = |(field, grid): &(&OccupancyField, Affine)| {
            let grid = grid.moved(low.map(|c| c as f64));
            let bounds = grid.bounds(size);
            (BlockBox::of_voxels(bounds[0], bounds[1]).contains_above(0, field), grid, bounds)
        };
        let placed: Vec<_> = grids.iter().map(|part| (part.0, around(part))).collect();
        // What is occupied somewhere comes first: then free space needs no second look.
        let (some, none) = placed.iter().partition::<Vec<_>, _>(|(_, (is_occupied, ..))| *is_occupied);
        for (field, (is_occupied, grid, bounds)) in some.into_iter().chain(none) {
            let is_known = |row: usize| {
                let at = low[0] + self.per_region * (low[1] + row % (high[1] - low[1]) + self.per_region * (low[2] + row / (high[1] - low[1])));
                self.values[at..at + high[0] - low[0]].iter().all(|value| *value != UNKNOWN)
            };
            if states_only && !is_occupied && (0..(high[1] - low[1]) * (high[2] - low[2])).all(is_known) {
                continue;
            }
            if window.fill(field, bounds) {
                dispatch(LookUp { values: &mut self.values, per_row: self.per_region, low, high, grid: &grid, window });
            }
        }
    }

    /// The values in the smallest cube `key` of the region.
    pub fn in_cube(&self, region: &Region<'_, '_>, key: u64) -> ValueRange {
        let mut found = ValueRange::EMPTY;
        self.points(local(region, key)).for_each(|at| found.add(self.values[at]));
        found
    }

    /// Indices of the points in the smallest cube at `c`, smallest cubes from the first corner of the region.
    #[inline(always)]
    fn points(&self, c: [u32; 3]) -> impl Iterator<Item = usize> + use<> {
        let (n, m) = (self.per_cube, self.per_region);
        let [x, y, z] = c.map(|c| c as usize * n);
        (0..n * n).flat_map(move |i| (0..n).map(move |dx| x + dx + m * (y + i % n + m * (z + i / n))))
    }
}

/// Coordinates of the smallest cube `key` in a region.
fn local(region: &Region<'_, '_>, key: u64) -> [u32; 3] {
    let c = morton::decode(key);
    std::array::from_fn(|k| c[k] - region.corner[k])
}

/// Looks up the points of a brick in a submap.
struct LookUp<'a> {
    values: &'a mut [i8],
    /// Points along each axis of all values.
    per_row: usize,
    low: [usize; 3],
    high: [usize; 3],
    /// From points, counted from the first of the brick, to finest voxels.
    grid: &'a Affine,
    window: &'a ValueBox,
}

impl Kernel for LookUp<'_> {
    #[inline(always)]
    fn run(self) {
        // 2^52: the number is in the low bits of the sum.
        const MAGIC: f64 = 4_503_599_627_370_496.0;
        let Self { values, per_row, low, high, grid, window } = self;
        let first = window.low.map(f64::from);
        let [nx, ny] = [window.size[0] as u32, window.size[1] as u32];
        let along_x: [f64; 3] = std::array::from_fn(|k| grid.linear[(k, 0)]);
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                let start = grid.apply([0.5, (y - low[1]) as f64 + 0.5, (z - low[2]) as f64 + 0.5]);
                let row = &mut values[low[0] + per_row * (y + per_row * z)..][..high[0] - low[0]];
                for (chunk, values) in row.chunks_mut(LANES).enumerate() {
                    let mut at = [0u32; LANES];
                    for (lane, at) in at.iter_mut().enumerate() {
                        let x = (chunk * LANES + lane) as f64;
                        let c: [u32; 3] = std::array::from_fn(|k| ((start[k] + x * along_x[k]).floor() - first[k] + MAGIC).to_bits() as u32);
                        *at = c[0].wrapping_add(nx.wrapping_mul(c[1].wrapping_add(ny.wrapping_mul(c[2]))));
                    }
                    for (value, at) in values.iter_mut().zip(at) {
                        *value = (*value).max(window.values.get(at as usize).copied().unwrap_or(UNKNOWN));
                    }
                }
            }
        }
    }
}

/// The values of a field in a box of finest voxels; those that are neither free nor occupied are [`UNKNOWN`].
#[derive(Default)]
struct ValueBox {
    low: [i32; 3],
    size: [usize; 3],
    values: Vec<i8>,
}

impl ValueBox {
    /// Takes the values from `low` to `high`, both included; false if none is known.
    fn fill(&mut self, field: &OccupancyField, [low, high]: [[i32; 3]; 2]) -> bool {
        self.low = low;
        self.size = std::array::from_fn(|k| (high[k] - low[k] + 1) as usize);
        self.values.clear();
        self.values.resize(self.size.iter().product(), UNKNOWN);
        let mut is_known = false;
        BlockBox::of_voxels(low, high).visit_leaves(field, &mut |summary| summary.max > UNKNOWN, &mut |leaf| {
            is_known = true;
            let corner = leaf.corner.map(|c| c << BLOCK_SHIFT);
            let edge = 8 << leaf.level;
            let from: [i32; 3] = std::array::from_fn(|k| corner[k].max(low[k]));
            let to: [i32; 3] = std::array::from_fn(|k| (corner[k] + edge).min(high[k] + 1));
            let block = (leaf.octant.link != NONE).then(|| field.block(leaf.octant.link));
            for z in from[2]..to[2] {
                for y in from[1]..to[1] {
                    let [at, end] = [from[0], to[0]].map(|x| self.index([x, y, z]));
                    let row = &mut self.values[at..end];
                    let Some(block) = block else {
                        row.fill(leaf.octant.payload.value);
                        continue;
                    };
                    let scale = usize::from(block.scale);
                    let within = |x: i32| voxel_index([x - corner[0], y - corner[1], z - corner[2]].map(|c| c as usize >> scale), scale);
                    let values = field.values(block);
                    if scale == 0 {
                        row.copy_from_slice(&values[within(from[0])..][..row.len()]);
                    } else {
                        row.iter_mut().zip(from[0]..).for_each(|(value, x)| *value = values[within(x)]);
                    }
                }
            }
            false
        });
        self.values.iter_mut().for_each(|value| *value = if *value == 0 { UNKNOWN } else { *value });
        is_known
    }

    fn index(&self, c: [i32; 3]) -> usize {
        let [x, y, z]: [usize; 3] = std::array::from_fn(|k| (c[k] - self.low[k]) as usize);
        x + self.size[0] * (y + self.size[1] * z)
    }
}
