//! The whole map on one grid of the map frame, as cubes of the largest size that has one value: for export to other maps.

use super::AtlasQuery;
use super::atlas::{Part, stronger};
use super::shape::moved;
use crate::field::occupancy::{State, UNKNOWN, state_of};
use crate::geometry::morton;
use crate::octree::{BLOCK_SHIFT, NONE, block_coords, voxel_coords};
use rayon::prelude::*;

/// On what grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampling {
    /// Edge of the smallest cube, metres: the map's finest voxel or larger. Cubes start at multiples of it.
    pub voxel: f64,
    /// Whether only states matter: cubes are then larger, and values are those of one voxel in them.
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

/// What [`Cube::corner`] has for the origin: the middle of what Morton keys hold.
pub(super) const ORIGIN: u32 = 1 << (morton::AXIS_BITS - 1);

/// What a submap knows of a region, or of a sampled cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Known {
    least: i8,
    most: i8,
    unknown: bool,
}

impl Known {
    const NOTHING: Self = Self { least: i8::MAX, most: i8::MIN, unknown: false };

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
    /// A smallest cube is asked at points no more than a finest voxel apart: it is occupied if one of them is, or if the
    /// middle of a finest voxel of occupied space lies in it (so that turning a map loses no wall), otherwise free if
    /// all points are. Where the grid is that of the only submap, all states are those of its voxels. The value is the
    /// largest among the points. Space beyond 2^20 smallest cubes from the origin is left out.
    pub fn resample(&self, to: &Resampling) -> Vec<Cube> {
        if self.is_empty() || !(to.voxel.is_finite() && to.voxel > 0.0) {
            return Vec::new();
        }
        let samples = ((to.voxel / self.voxel() - 1e-6).ceil() as usize).max(1);
        let occupied = self.occupied_cubes(to.voxel);
        let task = Task { query: self, to: *to, samples };
        let parts: Vec<&Part<'_>> = self.parts.iter().collect();
        let root = Job { corner: [0; 3], level: morton::AXIS_BITS, occupied: &occupied, parts };
        let mut jobs = vec![root];
        // Enough tasks for any number of threads, cut where the map and not the machine says.
        for _ in 0..morton::AXIS_BITS {
            if jobs.len() >= 512 {
                break;
            }
            jobs = jobs.iter().flat_map(|job| if job.level > 4 { task.split(job) } else { vec![job.clone()] }).collect();
        }
        let cubes: Vec<Vec<Cube>> = jobs
            .par_iter()
            .map(|job| {
                let mut cubes = Vec::new();
                task.run(job, &mut cubes);
                cubes
            })
            .collect();
        merge(cubes.concat())
    }

    /// Smallest cubes that hold the middle of a finest voxel of occupied space, with the largest value: sorted Morton keys.
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

/// Key of the smallest cube that holds `p`; none beyond what keys hold.
fn key_of(p: [f64; 3], voxel: f64) -> Option<u64> {
    let c = p.map(|c| (c / voxel).floor() + f64::from(ORIGIN));
    c.iter().all(|v| (0.0..f64::from(2 * ORIGIN)).contains(v)).then(|| morton::encode(c.map(|v| v as u32)))
}

impl Part<'_> {
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

    /// What the submap knows of everything within a ball around a cube of the map frame: more than the cube, never less.
    fn around(&self, middle: [f64; 3], radius: f64) -> Known {
        let mut known = Known::NOTHING;
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
        self.look(&mut known, (tree.root().link, tree.root().payload), root, tree.root_level(), [low, high]);
        known
    }

    fn look(&self, known: &mut Known, octant: (u32, crate::field::occupancy::Summary), corner: [i32; 3], level: u32, bounds: [[f64; 3]; 2]) {
        let edge = 8 << level;
        let [low, high] = bounds;
        if (0..3).any(|k| f64::from(corner[k]) > high[k] || f64::from(corner[k] + edge) < low[k]) {
            return;
        }
        let (link, summary) = octant;
        if link == NONE {
            known.add(summary.value);
        } else if level == 0 {
            let block = self.query.field.block(link);
            let scale = usize::from(block.scale);
            for (i, &value) in self.query.field.values(block).iter().enumerate() {
                let c = voxel_coords(i, scale);
                let first: [f64; 3] = std::array::from_fn(|k| f64::from(corner[k] + (c[k] << scale) as i32));
                if (0..3).all(|k| first[k] <= high[k] && first[k] + f64::from(1 << scale) >= low[k]) {
                    known.add(value);
                }
            }
        } else {
            for (i, child) in self.query.field.tree().siblings(link).iter().enumerate() {
                let at = std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 });
                self.look(known, (child.link, child.payload), at, level - 1, bounds);
            }
        }
    }
}

/// A cube to look into, with what may be in it.
#[derive(Clone)]
struct Job<'a, 'b> {
    corner: [u32; 3],
    level: u32,
    occupied: &'a [(u64, i8)],
    parts: Vec<&'a Part<'b>>,
}

struct Task<'a, 'b> {
    query: &'a AtlasQuery<'b>,
    to: Resampling,
    samples: usize,
}

impl<'a, 'b> Task<'a, 'b> {
    /// Cubes larger than this many finest voxels are not looked at as a whole: that would be a look at half the map.
    const LARGEST: f64 = 64.0;

    fn edge(&self, level: u32) -> f64 {
        self.to.voxel * f64::from(1u32 << level)
    }

    /// Middle of a cube, map frame.
    fn middle(&self, job: &Job<'_, '_>) -> [f64; 3] {
        let half = 0.5 * self.edge(job.level);
        job.corner.map(|c| (f64::from(c) - f64::from(ORIGIN)) * self.to.voxel + half)
    }

    /// The eight cubes within one, without those that nothing is known of.
    fn split(&self, job: &Job<'a, 'b>) -> Vec<Job<'a, 'b>> {
        let level = job.level - 1;
        let mut jobs = Vec::with_capacity(8);
        for i in 0..8u32 {
            let corner: [u32; 3] = std::array::from_fn(|k| job.corner[k] + ((i >> k & 1) << level));
            let first = morton::encode(corner);
            let end = first + (1u64 << (3 * level));
            let start = job.occupied.partition_point(|(key, _)| *key < first);
            let stop = job.occupied.partition_point(|(key, _)| *key < end);
            let mut child = Job { corner, level, occupied: &job.occupied[start..stop], parts: Vec::new() };
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

    fn run(&self, job: &Job<'a, 'b>, cubes: &mut Vec<Cube>) {
        if job.level == 0 {
            cubes.extend(self.smallest(job));
            return;
        }
        let edge = self.edge(job.level);
        if job.occupied.is_empty() && edge <= Self::LARGEST * self.query.voxel().max(self.to.voxel) {
            match self.uniform(job, 0.5 * edge * 3f64.sqrt()) {
                Some(UNKNOWN) => return,
                Some(value) => return cubes.push(Cube { corner: job.corner, level: job.level, value }),
                None => {}
            }
        }
        for child in self.split(job) {
            self.run(&child, cubes);
        }
    }

    /// The value that all smallest cubes of a cube without occupied space have, if it can be told at a glance.
    fn uniform(&self, job: &Job<'_, '_>, radius: f64) -> Option<i8> {
        let middle = self.middle(job);
        let (mut all_unknown, mut free) = (true, None::<i8>);
        let mut others_free = false;
        for part in &job.parts {
            let known = part.around(middle, radius);
            if known.most > 0 {
                return None;
            }
            all_unknown &= known.is_empty();
            if !known.is_empty() && !known.unknown && (known.least == known.most || self.to.states_only) {
                free = Some(free.map_or(known.most, |f| f.max(known.most)));
            } else {
                others_free |= !known.is_empty();
            }
        }
        if all_unknown {
            return Some(UNKNOWN);
        }
        free.filter(|_| self.to.states_only || !others_free)
    }

    fn smallest(&self, job: &Job<'_, '_>) -> Option<Cube> {
        let n = self.samples;
        let low: [f64; 3] = job.corner.map(|c| (f64::from(c) - f64::from(ORIGIN)) * self.to.voxel);
        let step = self.to.voxel / n as f64;
        let mut known = Known::NOTHING;
        for i in 0..n * n * n {
            let c = [i % n, i / n % n, i / (n * n)];
            let p: [f64; 3] = std::array::from_fn(|k| low[k] + (c[k] as f64 + 0.5) * step);
            known.add(job.parts.iter().fold(UNKNOWN, |best, part| stronger(best, part.value(p))));
        }
        let value = job.occupied.iter().map(|(_, v)| *v).chain((!known.is_empty()).then_some(known.most)).max()?;
        (value > 0 || !known.unknown).then_some(Cube { corner: job.corner, level: 0, value })
    }
}

/// Eight cubes of one value that fill a larger one become it.
fn merge(cubes: Vec<Cube>) -> Vec<Cube> {
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

/// The cube that the last eight fill, if they do.
fn parent_of_last(cubes: &[Cube]) -> Option<Cube> {
    let last = cubes.last()?;
    let eight = cubes.get(cubes.len().checked_sub(8)?..)?;
    let mask = !((2u32 << last.level) - 1);
    let corner = last.corner.map(|c| c & mask);
    let is_one = eight.iter().all(|c| c.level == last.level && c.value == last.value && c.corner.map(|v| v & mask) == corner);
    (is_one && last.level + 1 < morton::AXIS_BITS).then_some(Cube { corner, level: last.level + 1, value: last.value })
}
