//! The whole map on one grid of the map frame as cubes of uniform value: for export to other map formats.

use super::AtlasQuery;
use super::atlas::{PlacedField, union};
use super::shape::moved;
use crate::field::occupancy::{OccupancyField, State, Summary, UNKNOWN, state_of};
use crate::geometry::morton;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, block_key, voxel_coords, voxel_index};
use rayon::prelude::*;

/// The grid, and the precision of the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampling {
    /// Edge of the smallest cube, metres: the map's finest voxel or larger. The grid contains the origin.
    pub voxel: f64,
    /// Whether only states are needed: free cubes are larger then, and all have the value -1.
    pub states_only: bool,
}

/// A cube with one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cube {
    /// Smallest corner in multiples of the smallest cube's edge, plus 2^20.
    pub corner: [u32; 3],
    /// log2 of the edge in smallest cubes. Corners are multiples of the edge.
    pub level: u32,
    /// Log-odds in steps; never unknown.
    pub value: i8,
}

/// Value of [`Cube::corner`] at the origin: the middle of the range of Morton keys.
pub(super) const ORIGIN: u32 = 1 << (morton::AXIS_BITS - 1);

/// Range of the known values in a region, and whether some of it is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ValueRange {
    least: i8,
    most: i8,
    unknown: bool,
}

impl ValueRange {
    const EMPTY: Self = Self { least: i8::MAX, most: i8::MIN, unknown: false };

    fn add(&mut self, value: i8) {
        if state_of(value) == State::Unknown {
            self.unknown = true;
        } else {
            (self.least, self.most) = (self.least.min(value), self.most.max(value));
        }
    }

    fn is_empty(&self) -> bool {
        self.least > self.most
    }
}

impl AtlasQuery<'_> {
    /// The known part of the map on a grid, cubes in Morton order.
    ///
    /// A smallest cube is sampled at points no more than a finest voxel apart. It is occupied if one of them is, or if it contains the
    /// centre of an occupied finest voxel (so that rotated maps lose no wall); otherwise free if all points are. With a single submap on the
    /// same grid, all states are those of its voxels. The value is the largest among the points. Space beyond 2^20 smallest cubes from the
    /// origin is omitted.
    pub fn resample(&self, to: &Resampling) -> Vec<Cube> {
        if self.is_empty() || !(to.voxel.is_finite() && to.voxel > 0.0) {
            return Vec::new();
        }
        let samples = ((to.voxel / self.voxel_size() - 1e-6).ceil() as usize).max(1);
        let occupied = self.occupied_cubes(to.voxel);
        let resampler = Resampler { query: self, to: *to, samples };
        let parts: Vec<&PlacedField<'_>> = self.parts.iter().collect();
        let root = CubeTask { corner: [0; 3], level: morton::AXIS_BITS, occupied: &occupied, parts };
        let mut jobs = vec![root];
        // Enough tasks for any number of threads; how they are divided depends on the map alone.
        for _ in 0..morton::AXIS_BITS {
            if jobs.len() >= 512 {
                break;
            }
            jobs = jobs.iter().flat_map(|job| if job.level > 4 { resampler.split(job) } else { vec![job.clone()] }).collect();
        }
        let cubes: Vec<Vec<Cube>> = jobs
            .par_iter()
            .map(|job| {
                let mut cubes = Vec::new();
                resampler.run(job.clone(), &mut cubes);
                cubes
            })
            .collect();
        merge_siblings(cubes.concat())
    }

    /// Smallest cubes that contain the centre of an occupied finest voxel, with the largest value, sorted by Morton key.
    fn occupied_cubes(&self, voxel: f64) -> Vec<(u64, i8)> {
        let mut all: Vec<(u64, i8)> = self.parts.par_iter().flat_map_iter(|part| part.occupied_points(voxel)).collect();
        all.par_sort_unstable();
        // Of equal keys the last has the largest value.
        all.reverse();
        all.dedup_by_key(|(key, _)| *key);
        all.reverse();
        all
    }
}

/// Key of the smallest cube that contains `p`; none beyond the range of keys.
fn key_of(p: [f64; 3], voxel: f64) -> Option<u64> {
    let c = p.map(|c| (c / voxel).floor() + f64::from(ORIGIN));
    c.iter().all(|v| (0.0..f64::from(2 * ORIGIN)).contains(v)).then(|| morton::encode(c.map(|v| v as u32)))
}

impl PlacedField<'_> {
    fn occupied_points(&self, voxel: f64) -> Vec<(u64, i8)> {
        let mut points = Vec::new();
        let field = self.query.field;
        let mut push = |low: [i32; 3], edge: i32, value: i8| {
            for i in 0..edge * edge * edge {
                let c = [low[0] + i % edge, low[1] + i / edge % edge, low[2] + i / (edge * edge)];
                let middle = c.map(|v| (f64::from(v) + 0.5) * self.query.voxel);
                points.extend(key_of(moved(&self.t_map_submap, middle), voxel).map(|key| (key, value)));
            }
        };
        field.tree().for_each(|key, level, octant| {
            if octant.payload.max <= 0 || (level > 0 && octant.link != NONE) {
                return;
            }
            let corner = block_coords(key).map(|c| c << BLOCK_SHIFT);
            if octant.link == NONE {
                push(corner, 8 << level, octant.payload.value);
                return;
            }
            let block = field.block(octant.link);
            let scale = usize::from(block.scale);
            for (i, &value) in field.values(block).iter().enumerate().filter(|(_, v)| **v > 0) {
                let c = voxel_coords(i, scale);
                push(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), 1 << scale, value);
            }
        });
        points
    }

    /// Values of the submap within a ball around a cube of the map frame; incomplete once one is occupied and, if only states matter, once some
    /// are known and some are not.
    fn around(&self, middle: [f64; 3], radius: f64, states_only: bool) -> ValueRange {
        let mut known = ValueRange::EMPTY;
        let local = moved(&self.t_submap_map, middle);
        let (low, high) = (local.map(|c| c - radius), local.map(|c| c + radius));
        if !self.reaches(low, high) {
            known.unknown = true;
            return known;
        }
        let [low, high] = [low, high].map(|p| p.map(|c| c * self.query.per_metre));
        let tree = self.query.field.tree();
        let root = block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT);
        let edge = f64::from(8u32 << tree.root_level());
        known.unknown = (0..3).any(|k| low[k] < f64::from(root[k]) || high[k] > f64::from(root[k]) + edge);
        let mut collect = Collect { field: self.query.field, bounds: [low, high], states_only, known };
        collect.octant(*tree.root(), root, tree.root_level());
        collect.known
    }
}

/// Collects the values of a field within a box, finest voxels.
struct Collect<'a> {
    field: &'a OccupancyField,
    bounds: [[f64; 3]; 2],
    states_only: bool,
    known: ValueRange,
}

impl Collect<'_> {
    fn octant(&mut self, octant: Octant<Summary>, corner: [i32; 3], level: u32) {
        let edge = 8 << level;
        let [low, high] = self.bounds;
        let summary = octant.payload;
        let is_mixed = self.states_only && self.known.unknown && !self.known.is_empty();
        let adds_nothing = self.known.most > 0 || (is_mixed && summary.max <= 0);
        if adds_nothing || (0..3).any(|k| f64::from(corner[k]) > high[k] || f64::from(corner[k] + edge) < low[k]) {
            return;
        }
        if octant.link == NONE {
            self.known.add(summary.value);
        } else if summary.max == UNKNOWN || (self.states_only && summary.observed && summary.max < 0) {
            self.known.add(summary.max);
        } else if level == 0 {
            self.block(octant.link, corner);
        } else {
            for (i, &child) in self.field.tree().siblings(octant.link).iter().enumerate() {
                let at = std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 });
                self.octant(child, at, level - 1);
            }
        }
    }

    fn block(&mut self, id: u32, corner: [i32; 3]) {
        let [low, high] = self.bounds;
        let block = self.field.block(id);
        let (values, scale) = (self.field.values(block), usize::from(block.scale));
        // Along each axis the voxels that touch the box.
        let within: [[bool; BLOCK_EDGE]; 3] = std::array::from_fn(|k| {
            std::array::from_fn(|c| {
                let first = f64::from(corner[k] + (c << scale) as i32);
                first <= high[k] && first + f64::from(1 << scale) >= low[k]
            })
        });
        let n = BLOCK_EDGE >> scale;
        for z in (0..n).filter(|&z| within[2][z]) {
            for y in (0..n).filter(|&y| within[1][y]) {
                for x in (0..n).filter(|&x| within[0][x]) {
                    self.known.add(values[voxel_index([x, y, z], scale)]);
                }
            }
        }
    }
}

/// Looks up the values of a submap point by point: fast for points near each other.
struct Lookup<'a, 'b> {
    part: &'a PlacedField<'b>,
    /// Key of the block of the last point, and what is there.
    key: u64,
    found: Found<'a>,
}

/// What is at a block's place.
#[derive(Clone, Copy)]
enum Found<'a> {
    One(i8),
    Block { values: &'a [i8], scale: usize },
}

impl<'a, 'b> Lookup<'a, 'b> {
    fn new(part: &'a PlacedField<'b>) -> Self {
        Self { part, key: u64::MAX, found: Found::One(UNKNOWN) }
    }

    /// The same as [`PlacedField::value`].
    #[inline(always)]
    fn value(&mut self, p: [f64; 3]) -> i8 {
        let local = moved(&self.part.t_submap_map, p);
        if !self.part.reaches(local, local) {
            return UNKNOWN;
        }
        let Some(c) = self.part.query.voxel_of(local) else { return UNKNOWN };
        let key = block_key(c.map(|v| v >> BLOCK_SHIFT));
        if key != self.key {
            (self.key, self.found) = (key, self.find(key));
        }
        match self.found {
            Found::One(value) => value,
            Found::Block { values, scale } => values[voxel_index(c.map(|v| (v as usize & (BLOCK_EDGE - 1)) >> scale), scale)],
        }
    }

    fn find(&self, key: u64) -> Found<'a> {
        let field = self.part.query.field;
        match field.tree().find(key) {
            None => Found::One(UNKNOWN),
            Some((0, octant)) if octant.link != NONE => {
                let block = field.block(octant.link);
                Found::Block { values: field.values(block), scale: block.scale.into() }
            }
            Some((_, octant)) => Found::One(octant.payload.value),
        }
    }
}

/// A cube to resample, with the occupied smallest cubes in it and the submaps around it.
#[derive(Clone)]
struct CubeTask<'a, 'b> {
    corner: [u32; 3],
    level: u32,
    occupied: &'a [(u64, i8)],
    parts: Vec<&'a PlacedField<'b>>,
}

struct Resampler<'a, 'b> {
    query: &'a AtlasQuery<'b>,
    to: Resampling,
    samples: usize,
}

impl<'a, 'b> Resampler<'a, 'b> {
    /// Largest edge in finest voxels of cubes that are tested as a whole: for larger ones this would visit half the map.
    const MAX_EDGE: f64 = 64.0;
    /// Level of the cubes that are sampled cube by cube if they are not uniform.
    const SAMPLED_LEVEL: u32 = 3;

    fn edge(&self, level: u32) -> f64 {
        self.to.voxel * f64::from(1u32 << level)
    }

    /// Centre of a cube, map frame.
    fn middle(&self, job: &CubeTask<'_, '_>) -> [f64; 3] {
        let half = 0.5 * self.edge(job.level);
        job.corner.map(|c| (f64::from(c) - f64::from(ORIGIN)) * self.to.voxel + half)
    }

    /// The children of a cube that overlap the bounds of some submap.
    fn split(&self, job: &CubeTask<'a, 'b>) -> Vec<CubeTask<'a, 'b>> {
        let level = job.level - 1;
        let mut jobs = Vec::with_capacity(8);
        for i in 0..8u32 {
            let corner: [u32; 3] = std::array::from_fn(|k| job.corner[k] + ((i >> k & 1) << level));
            let first = morton::encode(corner);
            let end = first + (1u64 << (3 * level));
            let start = job.occupied.partition_point(|(key, _)| *key < first);
            let stop = job.occupied.partition_point(|(key, _)| *key < end);
            let mut child = CubeTask { corner, level, occupied: &job.occupied[start..stop], parts: Vec::new() };
            let (middle, radius) = (self.middle(&child), self.edge(level) * 0.5 * 3f64.sqrt());
            child.parts = job
                .parts
                .iter()
                .copied()
                .filter(|part| {
                    let p = moved(&part.t_submap_map, middle);
                    part.reaches(p.map(|c| c - radius), p.map(|c| c + radius))
                })
                .collect();
            if !child.parts.is_empty() {
                jobs.push(child);
            }
        }
        jobs
    }

    fn run(&self, mut job: CubeTask<'a, 'b>, cubes: &mut Vec<Cube>) {
        let edge = self.edge(job.level);
        if edge <= Self::MAX_EDGE * self.query.voxel_size().max(self.to.voxel) {
            match self.uniform(&mut job, 0.5 * edge * 3f64.sqrt()) {
                Some(UNKNOWN) => return,
                Some(value) => return cubes.push(Cube { corner: job.corner, level: job.level, value: self.stored(value) }),
                None => {}
            }
        }
        if job.level <= Self::SAMPLED_LEVEL {
            self.sample(&job, cubes);
        } else {
            self.split(&job).into_iter().for_each(|child| self.run(child, cubes));
        }
    }

    /// The value of all smallest cubes of a cube without occupied space, if the values around the cube determine it. Takes submaps that know nothing
    /// there off the list.
    fn uniform(&self, job: &mut CubeTask<'_, '_>, radius: f64) -> Option<i8> {
        let middle = self.middle(job);
        let (mut free, mut others_known) = (None::<i8>, !job.occupied.is_empty());
        job.parts.retain(|part| {
            let known = part.around(middle, radius, self.to.states_only);
            others_known |= known.most > 0;
            if !known.unknown && !known.is_empty() && known.most <= 0 && (known.least == known.most || self.to.states_only) {
                free = Some(free.map_or(known.most, |f| f.max(known.most)));
            } else {
                others_known |= !known.is_empty() && !self.to.states_only;
            }
            !known.is_empty()
        });
        if others_known {
            return None;
        }
        if job.parts.is_empty() { Some(UNKNOWN) } else { free }
    }

    /// Samples the smallest cubes of a cube, in Morton order.
    fn sample(&self, job: &CubeTask<'_, '_>, cubes: &mut Vec<Cube>) {
        let mut lookups: Vec<Lookup<'_, '_>> = job.parts.iter().map(|part| Lookup::new(part)).collect();
        let (first, mut occupied) = (morton::encode(job.corner), job.occupied);
        for key in first..first + (1 << (3 * job.level)) {
            let here = occupied.split_off(..occupied.partition_point(|(k, _)| *k == key)).unwrap_or_default();
            let corner = morton::decode(key);
            let value = self.smallest(corner, here, &mut lookups);
            cubes.extend(value.map(|value| Cube { corner, level: 0, value: self.stored(value) }));
        }
    }

    /// The value of the smallest cube at `corner`, in which the centres of the finest voxels `occupied` lie.
    fn smallest(&self, corner: [u32; 3], occupied: &[(u64, i8)], lookups: &mut [Lookup<'_, '_>]) -> Option<i8> {
        let n = self.samples;
        let low: [f64; 3] = corner.map(|c| (f64::from(c) - f64::from(ORIGIN)) * self.to.voxel);
        let step = self.to.voxel / n as f64;
        let mut known = ValueRange::EMPTY;
        for i in 0..n * n * n {
            let c = [i % n, i / n % n, i / (n * n)];
            let p: [f64; 3] = std::array::from_fn(|k| low[k] + (c[k] as f64 + 0.5) * step);
            known.add(lookups.iter_mut().fold(UNKNOWN, |best, lookup| union(best, lookup.value(p))));
        }
        let value = occupied.iter().map(|(_, v)| *v).chain((!known.is_empty()).then_some(known.most)).max()?;
        (value > 0 || !known.unknown).then_some(value)
    }

    fn stored(&self, value: i8) -> i8 {
        if self.to.states_only { value.max(-1) } else { value }
    }
}

/// Replaces eight cubes of one value that fill a larger cube by that cube.
fn merge_siblings(cubes: Vec<Cube>) -> Vec<Cube> {
    let mut merged: Vec<Cube> = Vec::with_capacity(cubes.len());
    for cube in cubes {
        merged.push(cube);
        while let Some(parent) = parent_of_last(&merged) {
            merged.truncate(merged.len() - 8);
            merged.push(parent);
        }
    }
    merged
}

/// The cube that the last eight fill, if any.
fn parent_of_last(cubes: &[Cube]) -> Option<Cube> {
    let last = cubes.last()?;
    let eight = cubes.get(cubes.len().checked_sub(8)?..)?;
    let mask = !((2u32 << last.level) - 1);
    let corner = last.corner.map(|c| c & mask);
    let is_one = eight.iter().all(|c| c.level == last.level && c.value == last.value && c.corner.map(|v| v & mask) == corner);
    (is_one && last.level + 1 < morton::AXIS_BITS).then_some(Cube { corner, level: last.level + 1, value: last.value })
}
