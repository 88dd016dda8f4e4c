//! Doubts: places that one submap calls occupied on the word of a single scan, and that the others together know to be free.
//!
//! In one submap a stray return is outvoted by the beams that pass there later. Between submaps it is not, because a place is occupied if any
//! submap says so. So the end of mapping does for such voxels what fusing the submaps would do for all: evidence adds up. Submaps may lie a
//! little apart, so voxels that more than one scan met are left alone, and so are the finest that have a surface of another submap beside them.

use super::Placement;
use super::occupancy::OccupancyPatch;
use crate::atlas::{Atlas, Submap};
use crate::field::occupancy::{OccupancyField, UNKNOWN};
use crate::octree::{BLOCK_EDGE, NONE, SCALES, block_coords, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;

/// How far around a doubtful voxel another submap's surface still is the same one, finest voxels.
const BESIDE: f32 = 3.0;

/// Largest uniform octant that is looked into, as a level: such an octant is made of single hits from afar.
const LARGEST: u32 = 2;

/// What the other submaps say of one submap's doubtful voxels, block by block.
pub(super) struct Doubts {
    /// Key of the block, and the evidence to add at each finest voxel; [`UNKNOWN`] for none.
    blocks: Vec<(u64, Box<[i8]>)>,
}

impl Doubts {
    /// For each submap, what the others say of its voxels that have at most `most` (steps of log-odds), wherever that makes them free.
    pub fn of(atlas: &Atlas, voxel: f32, most: i8) -> Vec<Self> {
        let submaps = atlas.submaps();
        submaps.par_iter().map(|submap| Self::of_submap(submap, submaps, voxel, most)).collect()
    }

    fn of_submap(submap: &Submap, all: &[Submap], voxel: f32, most: i8) -> Self {
        let others = all
            .iter()
            .filter(|other| other.id != submap.id && !other.occupancy.is_empty())
            .map(|other| (&other.occupancy, Placement::new(&submap.t_map_submap.inv_mul(&other.t_map_submap), voxel)))
            .collect();
        let witnesses = Witnesses { others };
        let mut blocks = Vec::new();
        let is_doubtful = |value: i8| (1..=most).contains(&value);
        submap.occupancy.tree().for_each(|key, level, octant| {
            if octant.link == NONE && level <= LARGEST && is_doubtful(octant.payload.value) {
                (0..1u64 << (3 * level)).for_each(|i| blocks.extend(witnesses.ask(key | i, 3, &[octant.payload.value], most)));
            } else if octant.link != NONE && level == 0 && octant.payload.max > 0 {
                let block = submap.occupancy.block(octant.link);
                blocks.extend(witnesses.ask(key, usize::from(block.scale), submap.occupancy.values(block), most));
            }
        });
        Self { blocks }
    }

    /// Adds the evidence to the submap that it was gathered for; returns how many finest voxels changed.
    pub fn settle(&self, field: &mut OccupancyField, limits: [i8; 2]) -> usize {
        let patch = OccupancyPatch::of_blocks(&self.blocks);
        patch.merge(0..patch.len(), field, limits);
        self.blocks.iter().map(|(_, more)| more.iter().filter(|v| **v != UNKNOWN).count()).sum()
    }
}

/// The submaps that may know better, each with its place in the doubtful one.
struct Witnesses<'a> {
    others: Vec<(&'a OccupancyField, Placement)>,
}

impl Witnesses<'_> {
    /// The evidence that makes doubtful voxels of a block free, at the finest scale; none where nobody knows better.
    fn ask(&self, key: u64, scale: usize, values: &[i8], most: i8) -> Option<(u64, Box<[i8]>)> {
        let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let mut more: Option<Box<[i8]>> = None;
        let half = 0.5 * (1 << scale) as f32;
        for (i, &value) in values.iter().enumerate().filter(|(_, v)| (1..=most).contains(*v)) {
            let first = voxel_coords(i, scale).map(|c| c << scale);
            let centre: [f32; 3] = std::array::from_fn(|k| corner[k] + first[k] as f32 + half);
            // Most doubts are nobody else's business: one look tells.
            if i32::from(value) + self.evidence(centre) >= 0 {
                continue;
            }
            let outvoted: Vec<(usize, i32)> = (0..voxels_at(SCALES - 1 - scale))
                .map(|sub| {
                    let within = voxel_coords(sub, SCALES - 1 - scale);
                    let c = [first[0] + within[0], first[1] + within[1], first[2] + within[2]];
                    (voxel_index(c, 0), self.evidence(std::array::from_fn(|k| corner[k] + c[k] as f32 + 0.5)))
                })
                .filter(|(_, evidence)| i32::from(value) + evidence < 0)
                .collect();
            // What was seen from so far that only larger voxels told it apart gives way also beside a surface: that one is known better.
            if scale > 0 || !self.see_a_surface(centre, half, most) {
                let more = more.get_or_insert_with(|| vec![UNKNOWN; voxels_at(0)].into());
                outvoted.into_iter().for_each(|(voxel, evidence)| more[voxel] = evidence.max(-127) as i8);
            }
        }
        more.map(|more| (key, more))
    }

    /// Whether any of the others has something occupied, no doubt of its own (`most`), around the voxel at `centre` that is `half` its
    /// edge to each side.
    fn see_a_surface(&self, centre: [f32; 3], half: f32, most: i8) -> bool {
        [half, half + 0.5 * BESIDE, half + BESIDE].into_iter().any(|r| {
            let steps = (0..27).filter(|i| *i != 13).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1].map(|d| d as f32 * r));
            steps.map(|d| [centre[0] + d[0], centre[1] + d[1], centre[2] + d[2]]).any(|p| self.values(p).any(|v| v > most))
        })
    }

    /// Sum of what the others hold at `p`, finest voxels of the doubtful submap.
    #[inline(always)]
    fn evidence(&self, p: [f32; 3]) -> i32 {
        self.values(p).filter(|v| *v != UNKNOWN).map(i32::from).sum()
    }

    fn values(&self, p: [f32; 3]) -> impl Iterator<Item = i8> {
        self.others.iter().map(move |(field, placement)| field.value_at(placement.t_source_target.apply(p).map(|v| v.floor() as i32)))
    }
}

#[cfg(test)]
mod tests {
    use crate::atlas::Atlas;
    use crate::atlas::fusion::{FusionSettings, settle_doubts};
    use crate::field::occupancy::{OccupancyField, State, UNKNOWN};
    use crate::geometry::Pose;
    use crate::octree::{Cursor, block_key, voxel_coords, voxel_index, voxels_at};
    use crate::settings::Settings;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    const VOXEL: f32 = 0.1;
    const HIT: f32 = 2.2;

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
        let patch = super::OccupancyPatch::of_blocks(&blocks);
        patch.merge(0..patch.len(), &mut field, [-64, 112]);
        field
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn a_single_hit_is_freed_where_the_others_outvote_it_and_nowhere_else(
            seed in any::<u64>(), angle in -3f64..3.0, shift in prop::array::uniform3(-0.3f64..0.3), witnesses in 1usize..4,
        ) {
            let noise = |c: [i32; 3], salt: u64| c.iter().fold(seed ^ salt, |h, v| (h ^ *v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)) >> 50;
            // One in sixteen is hit once, one in sixteen twice, a quarter unknown, the rest free.
            let first = |c: [i32; 3]| match noise(c, 1) % 16 { 0 => 70, 1 => 112, 2..6 => UNKNOWN, _ => -16 };
            let other = |w: u64| move |c: [i32; 3]| match noise(c.map(|v| v >> 2), 2 + w) % 4 { 0 => UNKNOWN, 1 => -16, _ => -64 };
            let mut atlas = Atlas::default();
            for w in 0..=witnesses {
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
            let freed = settle_doubts(&mut atlas, &FusionSettings::from(&Settings { voxel: VOXEL, ..Settings::default() }), HIT);
            let (mut expected, mut different) = (0, 0);
            for i in 0..32 * 32 * 32 {
                let c = [i % 32 - 16, i / 32 % 32 - 16, i / 1024 - 16];
                let value = before.submaps()[0].occupancy.value_at(c);
                let votes = |c: [f64; 3]| -> i32 {
                    let p = before.submaps()[0].t_map_submap * nalgebra::Point3::from(c.map(|v| v * f64::from(VOXEL)));
                    let said = before.submaps()[1..].iter().map(|s| {
                        let q = s.t_map_submap.inverse() * p;
                        i32::from(s.occupancy.value_at([q.x, q.y, q.z].map(|v| (v / f64::from(VOXEL)).floor() as i32)))
                    });
                    said.filter(|v| *v != i32::from(UNKNOWN)).sum()
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
            prop_assert!(witnesses == 1 || expected > 100);
            prop_assert!(before.submaps()[1..].iter().zip(&atlas.submaps()[1..]).all(|(a, b)| a.occupancy.volumes() == b.occupancy.volumes()));
        }
    }

    #[test]
    fn what_the_octants_say_follows() {
        // A lone hit in a free block: once freed, nothing in the tree says occupied.
        let lone = |c: [i32; 3]| if c == [3, 3, 3] { 70i8 } else { -64 };
        let free = |_: [i32; 3]| -64i8;
        let atlas_of = |values: [&dyn Fn([i32; 3]) -> i8; 3]| {
            let mut atlas = Atlas::default();
            for value in values {
                let id = atlas.spawn(Pose::identity());
                if let Some(submap) = atlas.submap_mut(id) {
                    submap.occupancy = field(value, |_| 0);
                }
            }
            atlas
        };
        // A wall of another submap, two voxels off, may be the same wall.
        let wall = |c: [i32; 3]| if c[0] == 5 { 112i8 } else { -64 };
        assert_eq!(settle_doubts(&mut atlas_of([&lone, &free, &wall]), &FusionSettings::from(&Settings::default()), HIT), 0);
        let mut atlas = atlas_of([&lone, &free, &free]);
        assert_eq!(settle_doubts(&mut atlas, &FusionSettings::from(&Settings::default()), HIT), 1);
        let field = &mut atlas.submaps_mut()[0].occupancy;
        assert!(field.tree().root().payload.max < 0);
        let id = field.make(&mut Cursor::new(&field.tree), block_key([0; 3]), 0);
        assert_eq!(field.values(field.block(id))[voxel_index([3; 3], 0)], 70 - 127);
    }
}
