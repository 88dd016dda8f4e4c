//! A map as it was at last: what later sessions saw to be gone is removed from earlier ones.

use super::fit::Fit;
use super::void::are_void;
use crate::atlas::fusion::{BlockVotes, FusionSettings, add_votes};
use crate::atlas::{Atlas, Submap, SubmapId};
use crate::field::occupancy::{BlockBox, OccupancyField, State, UNKNOWN};
use crate::field::tsdf::RemoveFrom;
use crate::geometry::{Pose, morton};
use crate::octree::{BLOCK_SHIFT, NONE, SCALES, block_key, voxel_coords, voxel_index, voxels_at};
use crate::query::AtlasQuery;
use hashbrown::HashMap;
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet};

/// A vote that makes a voxel free whatever was observed in it, steps of log-odds.
const FREE: i8 = -127;

/// What [`keep_newest`] removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RemovedVoxels {
    /// Voxels of surfaces that are unobserved now.
    pub surface: usize,
    /// Occupied finest voxels that are free now.
    pub occupied: usize,
}

/// Removes surfaces and occupied space from submaps where submaps of a larger `age`, such as those of a later session or lap, know free space only, within `margin` metres
/// as well, or more where the submap fits less well on the newer ones, see [`ChangeOptions::is_fitted`](super::ChangeOptions::is_fitted); beside what is gone, a third of the margin is enough, so that of a thing on the ground little more than its foot stays. Nothing changes where the newer submaps or the
/// older ones have no occupancy.
///
/// Runs in parallel; the result does not depend on the number of threads.
pub fn keep_newest(atlas: Atlas, age: impl Fn(SubmapId) -> u32, margin: f64, settings: &FusionSettings) -> (Atlas, RemovedVoxels) {
    let voxel_size = atlas.voxel_size();
    let mut by_age: BTreeMap<u32, Vec<Submap>> = BTreeMap::new();
    atlas.into_submaps().into_iter().for_each(|submap| by_age.entry(age(submap.id())).or_default().push(submap));
    let (mut newer, mut removed) = (Atlas::new(voxel_size), RemovedVoxels::default());
    for mut submaps in by_age.into_values().rev() {
        let query = AtlasQuery::new(&newer);
        if !query.is_empty() {
            for submap in &mut submaps {
                let margin = Fit::of([&*submap], &query, margin).margin_of_all();
                if !margin.is_finite() {
                    continue;
                }
                let RemovedVoxels { surface, occupied } = remove_vanished(submap, &query, margin, settings);
                removed = RemovedVoxels { surface: removed.surface + surface, occupied: removed.occupied + occupied };
            }
        }
        submaps.extend(newer.into_submaps());
        newer = Atlas::from_submaps(voxel_size, submaps);
    }
    (newer, removed)
}

/// Removes from `submap` what is not there any more in the `newer` map.
fn remove_vanished(submap: &mut Submap, newer: &AtlasQuery<'_>, margin: f64, settings: &FusionSettings) -> RemovedVoxels {
    let gone = GoneSpace::of(submap, newer, margin);
    if gone.cubes.is_empty() {
        return RemovedVoxels::default();
    }
    let is_gone = |centres: &[[f32; 3]]| gone.contains(centres);
    let surface = submap.tsdf.remove_voxels(RemoveFrom::Blocks(&gone.blocks), &is_gone);
    submap.tsdf.compact_all();
    let votes: Vec<BlockVotes> = gone.occupied_blocks(&submap.occupancy).par_iter().filter_map(|block| block.votes(&is_gone)).collect();
    let occupied = votes.iter().map(|(_, votes)| votes.iter().filter(|vote| **vote == FREE).count()).sum();
    add_votes(&mut submap.occupancy, &votes, settings);
    submap.revision += u64::from(surface + occupied > 0);
    RemovedVoxels { surface, occupied }
}

/// Space in which things of a submap were that are gone: with the whole margin to what the newer map has, and beside such space with a part of it. So what is left of
/// a thing where it stood on the ground goes with it.
struct GoneSpace<'a> {
    newer: &'a AtlasQuery<'a>,
    t_map_submap: Pose,
    /// Edge of a finest voxel, metres.
    voxel: f64,
    margin: f64,
    /// Edge of a cube, finest voxels: the margin, rounded up.
    edge: i32,
    /// Cubes of the submap frame in which something is gone, and those around them, by their coordinates in edges.
    cubes: HashSet<[i32; 3]>,
    /// Keys of the blocks that the cubes reach.
    blocks: HashSet<u64>,
}

impl<'a> GoneSpace<'a> {
    /// Part of the margin that is enough beside what is gone.
    const PART: f64 = 1.0 / 3.0;

    fn of(submap: &Submap, newer: &'a AtlasQuery<'a>, margin: f64) -> Self {
        /// Enough that many voxels are looked up together.
        const BLOCKS_PER_TASK: usize = 256;
        let voxel = f64::from(submap.voxel_size);
        let edge = (margin / voxel).ceil().max(1.0) as i32;
        let mut gone = Self { newer, t_map_submap: submap.t_map_submap, voxel, margin, edge, cubes: HashSet::new(), blocks: HashSet::new() };
        let cubes_of = |blocks: &[OccupiedBlock<'_>]| -> Vec<[i32; 3]> {
            let occupied: Vec<[f32; 3]> = blocks.iter().flat_map(|block| block.occupied().into_iter().map(|i| block.centre(i))).collect();
            let centres = gone.not_settled(&occupied);
            let are_gone = gone.are_void(&centres, margin);
            centres.iter().zip(are_gone).filter(|(_, gone)| *gone).map(|(c, _)| gone.cube(*c)).collect()
        };
        let found: HashSet<[i32; 3]> = occupied_blocks(&submap.occupancy).par_chunks(BLOCKS_PER_TASK).flat_map_iter(cubes_of).collect();
        let around =
            |c: &[i32; 3]| (0..27).map(|step| [step % 3, step / 3 % 3, step / 9]).map(|step| std::array::from_fn(|k| c[k] + step[k] - 1)).collect();
        gone.cubes = found.iter().flat_map(|c| -> Vec<[i32; 3]> { around(c) }).collect();
        gone.blocks = gone.cubes.iter().flat_map(|c| gone.blocks_of(c)).collect();
        gone
    }

    /// Those of some points of the submap, finest voxels, that may have nothing but free space within the margin: one point of each cube is asked first, and where that is
    /// not free, those within the margin of it are settled. As a rule what was there is there still.
    fn not_settled(&self, centres: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let between = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|k| f64::from(a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        let middle = |cube: &[i32; 3]| cube.map(|c| (c as f32 + 0.5) * self.edge as f32);
        let mut first: HashMap<[i32; 3], [f32; 3]> = HashMap::new();
        for c in centres {
            let cube = self.cube(*c);
            let middle = middle(&cube);
            first.entry(cube).and_modify(|first| *first = if between(c, &middle) < between(first, &middle) { *c } else { *first }).or_insert(*c);
        }
        let points: Vec<[f64; 3]> = first.values().map(|c| self.in_map(c)).collect();
        let states = self.newer.states(&points);
        let is_free: HashMap<[i32; 3], bool> = first.keys().copied().zip(states.into_iter().map(|state| state == State::Free)).collect();
        // A little less than the margin, for the rounding of points on its border.
        let near = 0.99 * self.margin / self.voxel;
        let may_be_void = |c: &&[f32; 3]| {
            let cube = self.cube(**c);
            is_free.get(&cube) != Some(&false) || first.get(&cube).is_none_or(|first| between(first, c) > near)
        };
        centres.iter().filter(may_be_void).copied().collect()
    }

    /// A point of the submap, finest voxels, in the map frame, metres.
    fn in_map(&self, c: &[f32; 3]) -> [f64; 3] {
        (self.t_map_submap * Point3::from(c.map(|c| f64::from(c) * self.voxel))).coords.into()
    }

    fn cube(&self, c: [f32; 3]) -> [i32; 3] {
        c.map(|c| (c.floor() as i32).div_euclid(self.edge))
    }

    /// Keys of the blocks that a cube reaches.
    fn blocks_of(&self, cube: &[i32; 3]) -> Vec<u64> {
        let [low, high] = [0, self.edge - 1].map(|end| cube.map(|c| (c * self.edge + end) >> BLOCK_SHIFT));
        let along = |k: usize| low[k]..=high[k];
        along(2).flat_map(|z| along(1).flat_map(move |y| along(0).map(move |x| block_key([x, y, z])))).collect()
    }

    /// The blocks with occupied voxels that it reaches.
    fn occupied_blocks<'f>(&self, field: &'f OccupancyField) -> Vec<OccupiedBlock<'f>> {
        let mut all = occupied_blocks(field);
        all.retain(|block| self.blocks.contains(&block.key()));
        all
    }

    /// Which of some points of the submap, finest voxels, are in it.
    fn contains(&self, centres: &[[f32; 3]]) -> Vec<bool> {
        let near: Vec<usize> = (0..centres.len()).filter(|&i| self.cubes.contains(&self.cube(centres[i]))).collect();
        let near_centres: Vec<[f32; 3]> = near.iter().map(|&i| centres[i]).collect();
        let mut gone = vec![false; centres.len()];
        near.into_iter().zip(self.are_void(&near_centres, Self::PART * self.margin)).for_each(|(i, is_gone)| gone[i] = is_gone);
        gone
    }

    /// Which of some points of the submap, finest voxels, have nothing but free space of the newer map within `margin`.
    fn are_void(&self, centres: &[[f32; 3]], margin: f64) -> Vec<bool> {
        let points: Vec<[f64; 3]> = centres.iter().map(|c| self.in_map(c)).collect();
        are_void(self.newer, &points, &self.newer.states(&points), |_| margin)
    }
}

/// A block with occupied voxels.
struct OccupiedBlock<'a> {
    /// Its smallest corner, finest voxels.
    corner: [i32; 3],
    scale: usize,
    values: &'a [i8],
}

/// All blocks with occupied voxels; a larger cube with one value is many.
fn occupied_blocks(field: &OccupancyField) -> Vec<OccupiedBlock<'_>> {
    /// Farther than a field reaches, finest voxels.
    const FAR: i32 = 1 << 28;
    let mut all = Vec::new();
    BlockBox::of_voxels([-FAR; 3], [FAR; 3]).visit_leaves(field, &mut |summary| summary.max > 0, &mut |leaf| {
        if leaf.octant.link != NONE {
            let block = field.block(leaf.octant.link);
            all.push(OccupiedBlock { corner: leaf.corner.map(|c| c << BLOCK_SHIFT), scale: block.scale.into(), values: field.values(block) });
            return false;
        }
        for i in 0..1u64 << (3 * leaf.level) {
            let at = morton::decode(i).map(|c| c as i32);
            let corner = std::array::from_fn(|k| (leaf.corner[k] + at[k]) << BLOCK_SHIFT);
            all.push(OccupiedBlock { corner, scale: SCALES - 1, values: std::slice::from_ref(&leaf.octant.payload.value) });
        }
        false
    });
    all
}

impl OccupiedBlock<'_> {
    /// Coordinates of the first finest voxel of voxel `i` in the block.
    fn first_voxel(&self, i: usize) -> [usize; 3] {
        voxel_coords(i, self.scale).map(|c| c << self.scale)
    }

    fn key(&self) -> u64 {
        block_key(self.corner.map(|c| c >> BLOCK_SHIFT))
    }

    /// The occupied voxels.
    fn occupied(&self) -> Vec<usize> {
        (0..self.values.len()).filter(|&i| self.values[i] > 0).collect()
    }

    /// The centre of voxel `i`, finest voxels.
    fn centre(&self, i: usize) -> [f32; 3] {
        let (first, half) = (self.first_voxel(i), 0.5 * (1 << self.scale) as f32);
        std::array::from_fn(|k| (self.corner[k] + first[k] as i32) as f32 + half)
    }

    /// Votes that free the voxels that are gone; none if no voxel is.
    fn votes(&self, is_gone: &impl Fn(&[[f32; 3]]) -> Vec<bool>) -> Option<BlockVotes> {
        let occupied = self.occupied();
        let centres: Vec<[f32; 3]> = occupied.iter().map(|&i| self.centre(i)).collect();
        let mut gone = occupied.into_iter().zip(is_gone(&centres)).filter(|(_, gone)| *gone).map(|(i, _)| i).peekable();
        gone.peek()?;
        let mut votes: Box<[i8]> = vec![UNKNOWN; voxels_at(0)].into();
        for i in gone {
            let first = self.first_voxel(i);
            for within in (0..voxels_at(SCALES - 1 - self.scale)).map(|sub| voxel_coords(sub, SCALES - 1 - self.scale)) {
                votes[voxel_index(std::array::from_fn(|k| first[k] + within[k]), 0)] = FREE;
            }
        }
        Some((self.key(), votes))
    }
}
