//! Conflicts between submaps: voxels that one submap has as occupied from a single hit and the others together as free.
//!
//! Within a submap a stray return is outvoted by beams that pass later. Between submaps it is not, because space is occupied if any submap
//! says so. So at the end of mapping such *contested* voxels get the log-odds of the other submaps added, as a fusion would do for all
//! voxels. Submaps may be misaligned by a few voxels, so voxels with more than one hit are not contested, and neither are finest voxels near
//! a surface of another submap.

use super::conflict_evidence::{Evidence, Neighbours, SURFACE_TOLERANCE, Voter};
use crate::atlas::fusion::occupancy::OccupancyPatch;
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::settings::FusionSettings;
use crate::atlas::{Atlas, Submap};
use crate::field::occupancy::{OccupancyField, Summary, UNKNOWN, steps};
use crate::octree::{BLOCK_EDGE, NONE, Octant, SCALES, block_coords, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;

/// Largest level of a uniform octant that may be contested: larger ones are not made of single hits.
const MAX_UNIFORM_LEVEL: u32 = 2;

/// Level of the subtrees (4 blocks along an edge) around which the other submaps are looked up at once.
const WINDOW_LEVEL: u32 = MAX_UNIFORM_LEVEL;

/// Level of the subtrees (16 blocks along an edge) that are searched in parallel.
const TASK_LEVEL: u32 = 4;

/// Adds the evidence of the other submaps to contested voxels: those that are occupied by at most one `hit` (log-odds) in one submap of
/// `atlas` and free by the sum of all. Returns the number of finest voxels that became free.
pub fn resolve_conflicts(atlas: &mut Atlas, settings: &FusionSettings, hit: f32) -> usize {
    let conflicts = Conflicts::of(atlas, steps(hit));
    let mut freed = 0;
    for (submap, conflicts) in atlas.submaps_mut().iter_mut().zip(conflicts) {
        let resolved = conflicts.resolve(&mut submap.occupancy, settings);
        submap.revision += u64::from(resolved > 0);
        freed += resolved;
    }
    freed
}

/// Contested voxels of one submap with the evidence of the others, by block.
struct Conflicts {
    blocks: Vec<BlockVotes>,
}

/// A block's key, and the log-odds (steps) to add at each finest voxel; [`UNKNOWN`] for none.
pub(crate) type BlockVotes = (u64, Box<[i8]>);

/// Adds votes to a field; sums stay within the limits of `settings`.
pub(crate) fn add_votes(field: &mut OccupancyField, votes: &[BlockVotes], settings: &FusionSettings) {
    let patch = OccupancyPatch::of_blocks(votes);
    patch.merge(0..patch.len(), field, settings.log_odds_limits());
}

impl Conflicts {
    /// The conflicts of each submap; voxels with more than `max_contested` steps of log-odds are not contested.
    fn of(atlas: &Atlas, max_contested: i8) -> Vec<Self> {
        let submaps = atlas.submaps();
        submaps.par_iter().map(|submap| Self::of_submap(submap, submaps, max_contested)).collect()
    }

    fn of_submap(submap: &Submap, all: &[Submap], max_contested: i8) -> Self {
        let placement = |other: &Submap| Placement::new(&submap.t_map_submap.inv_mul(&other.t_map_submap), submap.voxel_size);
        let voters: Vec<Voter<'_>> = all
            .iter()
            .filter(|other| other.id != submap.id && !other.occupancy.is_empty())
            .map(|other| Voter { field: &other.occupancy, placement: placement(other) })
            .collect();
        let search = ConflictSearch { field: &submap.occupancy, max_contested };
        let tree = submap.occupancy.tree();
        let root = Subtree { key: tree.root_key(), level: tree.root_level(), octant: tree.root(), voters: voters.iter().collect() };
        let mut tasks = vec![root];
        while tasks.iter().any(|task| task.level > TASK_LEVEL) {
            tasks = tasks.iter().flat_map(|task| if task.level > TASK_LEVEL { search.children(task) } else { vec![task.clone()] }).collect();
        }
        let blocks: Vec<Vec<BlockVotes>> = tasks
            .par_iter()
            .map(|task| {
                let mut blocks = Vec::new();
                search.descend(task, &mut blocks);
                blocks
            })
            .collect();
        Self { blocks: blocks.into_iter().flatten().collect() }
    }

    /// Adds the votes to the field of the submap; returns the number of finest voxels that changed.
    fn resolve(&self, field: &mut OccupancyField, settings: &FusionSettings) -> usize {
        add_votes(field, &self.blocks, settings);
        self.blocks.iter().map(|(_, votes)| votes.iter().filter(|v| **v != UNKNOWN).count()).sum()
    }
}

/// An octant of the contested submap and the submaps with observations around it.
#[derive(Clone)]
struct Subtree<'a> {
    key: u64,
    level: u32,
    octant: &'a Octant<Summary>,
    voters: Vec<&'a Voter<'a>>,
}

/// Search for the contested voxels of one submap.
struct ConflictSearch<'a> {
    field: &'a OccupancyField,
    max_contested: i8,
}

impl<'a> ConflictSearch<'a> {
    fn is_contested(&self, value: i8) -> bool {
        (1..=self.max_contested).contains(&value)
    }

    /// The children of a subtree that may hold contested voxels and have voters.
    fn children(&self, subtree: &Subtree<'a>) -> Vec<Subtree<'a>> {
        if subtree.octant.link == NONE {
            return Vec::new();
        }
        let level = subtree.level - 1;
        let children = self.field.tree().siblings(subtree.octant.link).iter().zip(0u64..);
        let may_be_contested = |octant: &Octant<Summary>| octant.payload.max > 0 && (octant.link != NONE || level <= MAX_UNIFORM_LEVEL);
        let child = |(octant, i): (&'a Octant<Summary>, u64)| {
            let key = subtree.key | i << (3 * level);
            let half = 0.5 * (BLOCK_EDGE << level) as f32;
            let centre = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32 + half);
            let has_observations = |v: &&&Voter<'a>| v.placement.blocks_in_source(centre, half + SURFACE_TOLERANCE).contains_above(UNKNOWN, v.field);
            let voters: Vec<&Voter<'a>> = subtree.voters.iter().filter(has_observations).copied().collect();
            (!voters.is_empty()).then_some(Subtree { key, level, octant, voters })
        };
        children.filter(|(octant, _)| may_be_contested(octant)).filter_map(child).collect()
    }

    fn descend(&self, subtree: &Subtree<'a>, found: &mut Vec<BlockVotes>) {
        if subtree.level > WINDOW_LEVEL {
            self.children(subtree).iter().for_each(|child| self.descend(child, found));
        } else {
            self.blocks(
                &Neighbours::around(&subtree.voters, subtree.key, subtree.level, self.max_contested),
                subtree.key,
                subtree.level,
                subtree.octant,
                found,
            );
        }
    }

    /// The votes in the blocks of an octant.
    fn blocks(&self, neighbours: &Neighbours<'a, '_>, key: u64, level: u32, octant: &Octant<Summary>, found: &mut Vec<BlockVotes>) {
        if octant.payload.max <= 0 {
            return;
        }
        if octant.link == NONE {
            found.extend((0..1u64 << (3 * level)).filter_map(|i| self.votes(neighbours, key | i, 3, &[octant.payload.value])));
        } else if level > 0 {
            let children = self.field.tree().siblings(octant.link).iter().zip(0u64..);
            children.for_each(|(child, i)| self.blocks(neighbours, key | i << (3 * (level - 1)), level - 1, child, found));
        } else {
            let block = self.field.block(octant.link);
            found.extend(self.votes(neighbours, key, usize::from(block.scale), self.field.values(block)));
        }
    }

    /// The votes that make contested voxels of a block free, at the finest scale; none if no voxel becomes free.
    fn votes(&self, neighbours: &Neighbours<'a, '_>, key: u64, scale: usize, values: &[i8]) -> Option<BlockVotes> {
        if !values.iter().any(|v| self.is_contested(*v)) {
            return None;
        }
        let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let evidence = Evidence::in_block(neighbours, corner);
        let mut votes: Option<Box<[i8]>> = None;
        // Most contested voxels have too few votes: one lookup rules them out.
        evidence.for_each_outvoted(values, scale, self.max_contested, |i| {
            let first = voxel_coords(i, scale).map(|c| c << scale);
            // Larger voxels were observed from afar: they become free also near a surface, which is known more precisely.
            if scale == 0 && neighbours.has_surface_near(std::array::from_fn(|k| corner[k] + first[k] as f32 + 0.5)) {
                return;
            }
            for sub in 0..voxels_at(SCALES - 1 - scale) {
                let within = voxel_coords(sub, SCALES - 1 - scale);
                let c = [first[0] + within[0], first[1] + within[1], first[2] + within[2]];
                let sum = evidence.sum_at(std::array::from_fn(|k| corner[k] + c[k] as f32 + 0.5));
                if i32::from(values[i]) + sum < 0 {
                    votes.get_or_insert_with(|| vec![UNKNOWN; voxels_at(0)].into())[voxel_index(c, 0)] = sum.max(-127) as i8;
                }
            }
        });
        votes.map(|votes| (key, votes))
    }
}

#[cfg(test)]
mod tests {
    use super::{Conflicts, FusionSettings, MAX_UNIFORM_LEVEL, OccupancyPatch, Placement, resolve_conflicts};
    use crate::atlas::{Atlas, Submap};
    use crate::field::occupancy::{OccupancyField, State, UNKNOWN};
    use crate::geometry::Pose;
    use crate::octree::{Cursor, NONE, block_coords, block_key, voxel_coords, voxel_index, voxels_at};
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    const VOXEL: f32 = 0.1;
    const HIT: f32 = 2.2;
    const SETTINGS: FusionSettings = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };

    /// A field of 4 x 4 x 4 blocks around its origin, each at a scale of its own.
    fn field(value: impl Fn([i32; 3]) -> i8, scale: impl Fn([i32; 3]) -> usize) -> OccupancyField {
        let mut blocks = Vec::new();
        for i in 0..64 {
            let block = [i % 4 - 2, i / 4 % 4 - 2, i / 16 - 2];
            let scale = scale(block);
            let corner = |v: usize| std::array::from_fn(|k| block[k] * 8 + (voxel_coords(v, scale)[k] << scale) as i32);
            let values = (0..voxels_at(scale)).map(|v| value(corner(v))).collect();
            blocks.push((block_key(block), values));
        }
        let mut field = OccupancyField::default();
        let patch = OccupancyPatch::of_blocks(&blocks);
        patch.merge(0..patch.len(), &mut field, [-64, 112]);
        field
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn a_single_hit_is_freed_exactly_where_the_others_outvote_it(
            seed in any::<u64>(), angle in -3f64..3.0, shift in prop::array::uniform3(-0.3f64..0.3), voters in 1usize..4,
        ) {
            let noise = |c: [i32; 3], salt: u64| c.iter().fold(seed ^ salt, |h, v| (h ^ *v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)) >> 50;
            // One in sixteen is hit once, one in sixteen twice, a quarter unknown, the rest free.
            let first = |c: [i32; 3]| match noise(c, 1) % 16 { 0 => 70, 1 => 112, 2..6 => UNKNOWN, _ => -16 };
            let other = |w: u64| move |c: [i32; 3]| match noise(c.map(|v| v >> 2), 2 + w) % 4 { 0 => UNKNOWN, 1 => -16, _ => -64 };
            let mut atlas = Atlas::new(VOXEL);
            for w in 0..=voters {
                let turn = UnitQuaternion::from_euler_angles(0.1 * w as f64, 0.0, angle * w as f64);
                let id = atlas.spawn(Pose::from_parts(Translation3::from(shift.map(|s| s * w as f64)), turn));
                if let Some(submap) = atlas.submap_mut(id) {
                    submap.occupancy = if w == 0 {
                        field(first, |b| b.iter().sum::<i32>().rem_euclid(4) as usize)
                    } else {
                        field(other(w as u64), |_| 0)
                    };
                }
            }
            let scale_of = |c: [i32; 3]| c.map(|v| v.div_euclid(8)).iter().sum::<i32>().rem_euclid(4) as u32;
            let before = atlas.clone();
            let freed = resolve_conflicts(&mut atlas, &SETTINGS, HIT);
            let (mut expected, mut different) = (0, 0);
            for i in 0..32 * 32 * 32 {
                let c = [i % 32 - 16, i / 32 % 32 - 16, i / 1024 - 16];
                let value = before.submaps()[0].occupancy.value_at(c);
                let votes = |c: [f64; 3]| -> i32 {
                    let p = before.submaps()[0].t_map_submap * nalgebra::Point3::from(c.map(|v| v * f64::from(VOXEL)));
                    let values = before.submaps()[1..].iter().map(|s| {
                        let q = s.t_map_submap.inverse() * p;
                        i32::from(s.occupancy.value_at([q.x, q.y, q.z].map(|v| (v / f64::from(VOXEL)).floor() as i32)))
                    });
                    values.filter(|v| *v != i32::from(UNKNOWN)).sum()
                };
                let edge = 1 << scale_of(c);
                let middle = c.map(|v| f64::from(v.div_euclid(edge) * edge) + 0.5 * f64::from(edge));
                let is_outvoted = |p: [f64; 3]| i32::from(value) + votes(p) < 0;
                let outvoted = (1..=70).contains(&value) && is_outvoted(middle) && is_outvoted(c.map(|v| f64::from(v) + 0.5));
                expected += usize::from(outvoted);
                let now = atlas.submaps()[0].occupancy.value_at(c);
                let right = if outvoted { crate::field::occupancy::state_of(now) == State::Free } else { now == value };
                different += usize::from(!right);
            }
            // Points on a face of a voxel may round to either side.
            prop_assert!(different <= 4 && freed.abs_diff(expected) <= 4, "{different} different, {freed} freed, {expected} expected");
            prop_assert!(voters == 1 || expected > 100);
            prop_assert!(before.submaps()[1..].iter().zip(&atlas.submaps()[1..]).all(|(a, b)| a.occupancy.volumes() == b.occupancy.volumes()));
        }
    }

    /// Votes for a submap's contested voxels, each looked up from the root: the definition of [`Conflicts`].
    fn slow(submap: &Submap, all: &[Submap], max_contested: i8) -> BTreeMap<u64, Vec<i8>> {
        let others = all.iter().filter(|other| other.id != submap.id);
        let others: Vec<(&Submap, Placement)> =
            others.map(|other| (other, Placement::new(&submap.t_map_submap.inv_mul(&other.t_map_submap), VOXEL))).collect();
        let values = |p: [f32; 3]| {
            let value = |(other, t): &(&Submap, Placement)| other.occupancy.value_at(t.t_source_target.apply(p).map(|v| v.floor() as i32));
            others.iter().map(value).collect::<Vec<_>>()
        };
        let votes = |p| -> i32 { values(p).into_iter().filter(|v| *v != UNKNOWN).map(i32::from).sum() };
        let mut found = BTreeMap::new();
        let mut vote = |first: [i32; 3], edge: i32, value: i8| {
            let centre = first.map(|c| c as f32 + 0.5 * edge as f32);
            let outvoted = |p| i32::from(value) + votes(p) < 0;
            let at = |i: i32, r: f32| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1].map(|d| d as f32 * r);
            let is_wall = |i, r| values(std::array::from_fn(|k| centre[k] + at(i, r)[k])).into_iter().any(|v| v > max_contested);
            if !(1..=max_contested).contains(&value) || !outvoted(centre) {
                return;
            }
            if edge == 1 && [0.5, 2.0, 3.5].into_iter().any(|r| (0..27).any(|i| i != 13 && is_wall(i, r))) {
                return;
            }
            for i in 0..edge.pow(3) {
                let c = [first[0] + i % edge, first[1] + i / edge % edge, first[2] + i / (edge * edge)];
                let middle = c.map(|v| v as f32 + 0.5);
                if outvoted(middle) {
                    let block: &mut Vec<i8> = found.entry(block_key(c.map(|v| v >> 3))).or_insert_with(|| vec![UNKNOWN; 512]);
                    block[voxel_index(c.map(|v| (v & 7) as usize), 0)] = votes(middle).max(-127) as i8;
                }
            }
        };
        submap.occupancy.tree().for_each(|key, level, octant| {
            let corner = |key| block_coords(key).map(|c| 8 * c);
            if octant.link == NONE && level <= MAX_UNIFORM_LEVEL {
                (0..1 << (3 * level)).for_each(|i| vote(corner(key | i), 8, octant.payload.value));
            } else if octant.link != NONE && level == 0 {
                let block = submap.occupancy.block(octant.link);
                for (i, value) in submap.occupancy.values(block).iter().enumerate() {
                    let c = voxel_coords(i, block.scale.into());
                    vote(std::array::from_fn(|k| corner(key)[k] + (c[k] << block.scale) as i32), 1 << block.scale, *value);
                }
            }
        });
        found
    }

    /// Submaps of noise, rotated and shifted against each other.
    fn noisy_atlas(seed: u64, turns: &[[f64; 3]], spread: f64, detail: u32) -> Atlas {
        let noise =
            |c: [i32; 3], salt: u64| c.iter().fold(seed ^ salt, |h, v| (h ^ *v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)) >> 50;
        let mut atlas = Atlas::new(VOXEL);
        for (w, &[roll, pitch, yaw]) in (0u64..).zip(turns) {
            // Cubes of one value in two sizes, with occasional surfaces, single hits and unknown voxels.
            let value = |c: [i32; 3]| match (noise(c, w) % 64, noise(c.map(|v| v >> (2 + detail)), 9 + w) % 16) {
                (0..2, _) => 112,
                (2..6, _) | (_, 0) => 70,
                (6..8, _) | (_, 1..5) => UNKNOWN,
                (_, 5) => 35,
                (_, 6..9) => -16,
                _ => -64,
            };
            let shift = Translation3::new(spread * roll.sin(), spread * pitch.sin(), 0.3 * yaw);
            let id = atlas.spawn(Pose::from_parts(shift, UnitQuaternion::from_euler_angles(0.1 * roll, 0.1 * pitch, yaw)));
            if let Some(submap) = atlas.submap_mut(id) {
                submap.occupancy = field(value, |b| (noise(b, 5 + w) % 4) as usize);
            }
        }
        atlas
    }

    /// Number of votes, and whether they equal those of the search voxel by voxel.
    fn compare(atlas: &Atlas) -> (usize, bool) {
        let (mut count, mut is_equal) = (0, true);
        for (submap, conflicts) in atlas.submaps().iter().zip(Conflicts::of(atlas, 70)) {
            let votes: BTreeMap<u64, Vec<i8>> = conflicts.blocks.into_iter().map(|(key, votes)| (key, votes.into())).collect();
            let slow = slow(submap, atlas.submaps(), 70);
            count += slow.values().flatten().filter(|v| **v != UNKNOWN).count();
            is_equal &= votes == slow;
        }
        (count, is_equal)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn conflicts_equal_those_found_voxel_by_voxel(
            seed in any::<u64>(), turns in prop::collection::vec(prop::array::uniform3(-3f64..3.0), 2..5), spread in 0f64..3.0, detail in 0u32..3,
        ) {
            prop_assert!(compare(&noisy_atlas(seed, &turns, spread, detail)).1);
        }
    }

    #[test]
    fn noise_contains_conflicts() {
        let (count, is_equal) = compare(&noisy_atlas(7, &[[0.4, -1.1, 2.0], [1.5, 0.3, -0.7], [-2.0, 1.0, 0.2]], 0.8, 1));
        assert!(is_equal && count > 100, "{count}");
    }

    #[test]
    fn octants_are_updated_and_hits_near_a_surface_stay() {
        // A single hit in a free block: once it is freed, no octant is occupied.
        let lone = |c: [i32; 3]| if c == [3, 3, 3] { 70i8 } else { -64 };
        let free = |_: [i32; 3]| -64i8;
        let atlas_of = |values: [&dyn Fn([i32; 3]) -> i8; 3]| {
            let mut atlas = Atlas::new(VOXEL);
            for value in values {
                let id = atlas.spawn(Pose::identity());
                if let Some(submap) = atlas.submap_mut(id) {
                    submap.occupancy = field(value, |_| 0);
                }
            }
            atlas
        };
        // A wall of another submap at a distance of two voxels may be the same wall.
        let wall = |c: [i32; 3]| if c[0] == 5 { 112i8 } else { -64 };
        assert_eq!(resolve_conflicts(&mut atlas_of([&lone, &free, &wall]), &SETTINGS, HIT), 0);
        let mut atlas = atlas_of([&lone, &free, &free]);
        assert_eq!(resolve_conflicts(&mut atlas, &SETTINGS, HIT), 1);
        let field = &mut atlas.submaps_mut()[0].occupancy;
        assert!(field.tree().root().payload.max < 0);
        let id = field.find_or_create(&mut Cursor::new(&field.tree), block_key([0; 3]), 0);
        assert_eq!(field.values(field.block(id))[voxel_index([3; 3], 0)], 70 - 127);
    }
}
