//! The whole map on one grid of the map frame as cubes of uniform value: for export to other map formats.

mod occupied;
mod region;
mod sample;

use super::AtlasQuery;
use super::atlas::PlacedField;
use super::shape::moved;
use crate::field::occupancy::UNKNOWN;
use crate::geometry::morton;
use rayon::prelude::*;
use sample::Samples;

/// The grid, and the precision of the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampling {
    /// Edge of the smallest cube, metres: the map's finest voxel or larger. The grid contains the origin.
    pub voxel: f64,
    /// Whether only states are needed: free cubes all have the value -1 then and occupied ones 1, so that they are larger.
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
const ORIGIN: u32 = 1 << (morton::AXIS_BITS - 1);

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
        let resampler = Resampler { voxel_size: self.voxel_size(), to: *to, samples };
        let mut parts = vec![Region { corner: [0; 3], level: morton::AXIS_BITS, submaps: self.parts.iter().collect() }];
        // Enough parts for any number of threads; how space is divided depends on the map alone.
        for _ in 0..morton::AXIS_BITS {
            if parts.len() >= 512 {
                break;
            }
            parts = parts.into_iter().flat_map(|region| if region.level > 4 { resampler.split(&region) } else { vec![region] }).collect();
        }
        let resampled: Vec<Vec<Cube>> = parts.into_par_iter().map(|region| resampler.part(region)).collect();
        let mut cubes = Vec::with_capacity(resampled.iter().map(Vec::len).sum());
        resampled.into_iter().for_each(|part| cubes.extend(part));
        merge_siblings(&mut cubes);
        cubes
    }
}

/// A cube to resample, and the submaps around it.
#[derive(Clone)]
struct Region<'a, 'b> {
    corner: [u32; 3],
    level: u32,
    submaps: Vec<&'a PlacedField<'b>>,
}

struct Resampler {
    /// Edge of the map's finest voxel, metres.
    voxel_size: f64,
    to: Resampling,
    /// Points along an edge of a smallest cube.
    samples: usize,
}

impl Resampler {
    /// Largest edge in finest voxels of cubes that are tested as a whole: for larger ones this would visit half the map.
    const MAX_EDGE: f64 = 64.0;
    /// Most points along an edge of the cubes that are sampled as a whole, unless they are the smallest.
    const MOST_SAMPLES: usize = 32;

    fn edge(&self, level: u32) -> f64 {
        self.to.voxel * f64::from(1u32 << level)
    }

    /// First corner of a smallest cube, map frame.
    fn corner(&self, corner: [u32; 3]) -> [f64; 3] {
        corner.map(|c| (f64::from(c) - f64::from(ORIGIN)) * self.to.voxel)
    }

    /// Centre of a cube, map frame, and the radius of the ball around it.
    fn ball(&self, region: &Region<'_, '_>) -> ([f64; 3], f64) {
        let half = 0.5 * self.edge(region.level);
        (self.corner(region.corner).map(|c| c + half), half * 3f64.sqrt())
    }

    /// The children of a cube that overlap the bounds of some submap.
    fn split<'a, 'b>(&self, region: &Region<'a, 'b>) -> Vec<Region<'a, 'b>> {
        let level = region.level - 1;
        let child = |i: u32| {
            let corner = std::array::from_fn(|k| region.corner[k] + ((i >> k & 1) << level));
            let mut child = Region { corner, level, submaps: Vec::new() };
            let (middle, radius) = self.ball(&child);
            let is_near = |submap: &&PlacedField<'_>| {
                let p = moved(&submap.t_submap_map, middle);
                submap.reaches(p.map(|c| c - radius), p.map(|c| c + radius))
            };
            child.submaps = region.submaps.iter().copied().filter(is_near).collect();
            (!child.submaps.is_empty()).then_some(child)
        };
        (0..8).filter_map(child).collect()
    }

    /// The cubes of a part of the map.
    fn part(&self, region: Region<'_, '_>) -> Vec<Cube> {
        let occupied = self.occupied_cubes(&region);
        let mut cubes = Vec::new();
        self.descend(region, &occupied, &mut cubes);
        merge_siblings(&mut cubes);
        cubes.shrink_to_fit();
        cubes
    }

    /// Adds the cubes of a region, of whose smallest cubes `occupied` contain the centre of an occupied voxel.
    fn descend(&self, mut region: Region<'_, '_>, occupied: &[(u64, i8)], cubes: &mut Vec<Cube>) {
        if self.edge(region.level) <= Self::MAX_EDGE * self.voxel_size.max(self.to.voxel) {
            match self.uniform(&mut region, occupied) {
                Some(UNKNOWN) => return,
                Some(value) => return cubes.push(Cube { corner: region.corner, level: region.level, value: self.stored(value) }),
                None => {}
            }
        }
        if region.level == 0 || (region.level <= 3 && self.samples << region.level <= Self::MOST_SAMPLES) {
            self.sample(&region, occupied, cubes);
            return;
        }
        for child in self.split(&region) {
            let first = morton::encode(child.corner);
            let [start, end] = [first, first + (1 << (3 * child.level))].map(|bound| occupied.partition_point(|(key, _)| *key < bound));
            self.descend(child, &occupied[start..end], cubes);
        }
    }

    /// The value of all smallest cubes of a cube without occupied space, if the values around the cube determine it. Takes submaps that know nothing
    /// there off the list.
    fn uniform(&self, region: &mut Region<'_, '_>, occupied: &[(u64, i8)]) -> Option<i8> {
        let (middle, radius) = self.ball(region);
        let (mut free, mut others_known) = (None::<i8>, !occupied.is_empty());
        region.submaps.retain(|submap| {
            let known = submap.around(middle, radius, self.to.states_only);
            others_known |= known.most() > 0;
            if known.is_free(self.to.states_only) {
                free = Some(free.map_or(known.most(), |f| f.max(known.most())));
            } else {
                others_known |= !known.is_empty() && !self.to.states_only;
            }
            !known.is_empty()
        });
        if others_known {
            return None;
        }
        if region.submaps.is_empty() { Some(UNKNOWN) } else { free }
    }

    /// Samples the smallest cubes of a cube, in Morton order.
    fn sample(&self, region: &Region<'_, '_>, mut occupied: &[(u64, i8)], cubes: &mut Vec<Cube>) {
        let samples = Samples::new(self, region, occupied);
        let first = morton::encode(region.corner);
        for key in first..first + (1 << (3 * region.level)) {
            let found = samples.in_cube(region, key);
            let value = match occupied.split_off(..occupied.partition_point(|(k, _)| *k == key)).and_then(<[_]>::last) {
                Some((_, value)) => Some(found.most().max(*value)),
                None => found.of_cube(),
            };
            cubes.extend(value.map(|value| Cube { corner: morton::decode(key), level: 0, value: self.stored(value) }));
        }
    }

    fn stored(&self, value: i8) -> i8 {
        if self.to.states_only { value.clamp(-1, 1) } else { value }
    }
}

/// Replaces eight cubes of one value that fill a larger cube by that cube.
fn merge_siblings(cubes: &mut Vec<Cube>) {
    let mut merged = 0;
    for i in 0..cubes.len() {
        cubes[merged] = cubes[i];
        merged += 1;
        while let Some(parent) = parent_of_last(&cubes[..merged]) {
            merged -= 7;
            cubes[merged - 1] = parent;
        }
    }
    cubes.truncate(merged);
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
