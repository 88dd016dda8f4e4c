//! The whole map on one grid of the map frame as cubes of uniform value: for export to other map formats.

mod grid;
mod occupied;
mod region;
mod sample;

use super::AtlasQuery;
use crate::field::occupancy::UNKNOWN;
use crate::geometry::morton;
pub use grid::{Cube, Resampling};
use grid::{Region, Resampler};
use rayon::prelude::*;
use sample::Samples;

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
        let resampler = self.resampler(to);
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

    /// The known part of one cube of the grid of [`resample`](Self::resample), whose corner and level are as in [`Cube`]: states are the same, but for what rounding decides. It
    /// depends on nothing but what submaps have there.
    pub fn resample_cube(&self, to: &Resampling, corner: [u32; 3], level: u32) -> Vec<Cube> {
        if self.is_empty() || !(to.voxel.is_finite() && to.voxel > 0.0) || level >= morton::AXIS_BITS {
            return Vec::new();
        }
        let resampler = self.resampler(to);
        let mut region = Region { corner, level, submaps: self.parts.iter().collect() };
        resampler.keep_near(&mut region);
        if region.submaps.is_empty() { Vec::new() } else { resampler.part(region) }
    }

    fn resampler(&self, to: &Resampling) -> Resampler {
        let samples = ((to.voxel / self.voxel_size() - 1e-6).ceil() as usize).max(1);
        Resampler { voxel_size: self.voxel_size(), to: *to, samples }
    }
}

impl Resampler {
    /// Largest edge in finest voxels of cubes that are tested as a whole: for larger ones this would visit half the map.
    const MAX_EDGE: f64 = 64.0;
    /// Most points along an edge of the cubes that are sampled as a whole, unless they are the smallest.
    const MOST_SAMPLES: usize = 32;

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
