//! Doubts: places that one submap calls occupied on the word of a single scan, and that the others together know to be free.
//!
//! In one submap a stray return is outvoted by the beams that pass there later. Between submaps it is not, because a place is occupied if any
//! submap says so. So the end of mapping does for such voxels what fusing the submaps would do for all: evidence adds up. Submaps may lie a
//! little apart, so voxels that more than one scan met are left alone, and so are the finest that have a surface of another submap beside them.

use super::Placement;
use super::occupancy::OccupancyPatch;
use super::window::{Blocks, MARGIN, Window};
use crate::atlas::{Atlas, Submap};
use crate::field::occupancy::{OccupancyField, Summary, UNKNOWN};
use crate::octree::{BLOCK_EDGE, NONE, Octant, SCALES, block_coords, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;

/// How far around a doubtful voxel another submap's surface still is the same one, finest voxels.
const BESIDE: f32 = 3.0;

/// Largest uniform octant that is looked into, as a level: such an octant is made of single hits from afar.
const LARGEST: u32 = 2;

/// Subtrees up to this level (16 blocks) are looked through in parallel.
const TASK_LEVEL: u32 = 4;

/// What the other submaps say of one submap's doubtful voxels, block by block.
pub(super) struct Doubts {
    /// Key of the block, and the evidence to add at each finest voxel; [`UNKNOWN`] for none.
    blocks: Vec<Evidence>,
}

/// A block's key, and what is to be added at each finest voxel.
type Evidence = (u64, Box<[i8]>);

impl Doubts {
    /// For each submap, what the others say of its voxels that have at most `most` (steps of log-odds), wherever that makes them free.
    pub fn of(atlas: &Atlas, voxel: f32, most: i8) -> Vec<Self> {
        let submaps = atlas.submaps();
        submaps.par_iter().map(|submap| Self::of_submap(submap, submaps, voxel, most)).collect()
    }

    fn of_submap(submap: &Submap, all: &[Submap], voxel: f32, most: i8) -> Self {
        let others: Vec<Witness<'_>> = all
            .iter()
            .filter(|other| other.id != submap.id && !other.occupancy.is_empty())
            .map(|other| Witness { field: &other.occupancy, placement: Placement::new(&submap.t_map_submap.inv_mul(&other.t_map_submap), voxel) })
            .collect();
        let hearing = Hearing { field: &submap.occupancy, most };
        let tree = submap.occupancy.tree();
        let mut places = vec![Place { key: tree.root_key(), level: tree.root_level(), octant: tree.root(), witnesses: others.iter().collect() }];
        while places.iter().any(|p| p.level > TASK_LEVEL) {
            places = places.iter().flat_map(|place| if place.level > TASK_LEVEL { hearing.open(place) } else { vec![place.clone()] }).collect();
        }
        let parts: Vec<Vec<Evidence>> = places
            .par_iter()
            .map(|place| {
                let mut found = Vec::new();
                hearing.descend(place, &mut found);
                found
            })
            .collect();
        Self { blocks: parts.into_iter().flatten().collect() }
    }

    /// Adds the evidence to the submap that it was gathered for; returns how many finest voxels changed.
    pub fn settle(&self, field: &mut OccupancyField, limits: [i8; 2]) -> usize {
        let patch = OccupancyPatch::of_blocks(&self.blocks);
        patch.merge(0..patch.len(), field, limits);
        self.blocks.iter().map(|(_, more)| more.iter().filter(|v| **v != UNKNOWN).count()).sum()
    }
}

/// Another submap, which may know better, and its place in the doubtful one.
struct Witness<'a> {
    field: &'a OccupancyField,
    placement: Placement,
}

/// An octant of the doubtful submap, and who knows anything around it.
#[derive(Clone)]
struct Place<'a> {
    key: u64,
    level: u32,
    octant: &'a Octant<Summary>,
    witnesses: Vec<&'a Witness<'a>>,
}

/// The search of one submap for doubts.
struct Hearing<'a> {
    field: &'a OccupancyField,
    most: i8,
}

impl<'a> Hearing<'a> {
    fn is_doubtful(&self, value: i8) -> bool {
        (1..=self.most).contains(&value)
    }

    /// The children of a place that may hold doubts and have witnesses.
    fn open(&self, place: &Place<'a>) -> Vec<Place<'a>> {
        if place.octant.link == NONE {
            return Vec::new();
        }
        let level = place.level - 1;
        let children = self.field.tree().siblings(place.octant.link).iter().zip(0u64..);
        let may_doubt = |octant: &Octant<Summary>| octant.payload.max > 0 && (octant.link != NONE || level <= LARGEST);
        let child = |(octant, i): (&'a Octant<Summary>, u64)| {
            let key = place.key | i << (3 * level);
            let half = 0.5 * (BLOCK_EDGE << level) as f32;
            let centre = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32 + half);
            let knows = |w: &&&Witness<'a>| Blocks::around(&w.placement, centre, half + BESIDE).have_more_than(UNKNOWN, w.field);
            let witnesses: Vec<&Witness<'a>> = place.witnesses.iter().filter(knows).copied().collect();
            (!witnesses.is_empty()).then_some(Place { key, level, octant, witnesses })
        };
        children.filter(|(octant, _)| may_doubt(octant)).filter_map(child).collect()
    }

    fn descend(&self, place: &Place<'a>, found: &mut Vec<Evidence>) {
        let Place { key, level, octant, ref witnesses } = *place;
        if octant.link == NONE {
            let blocks = if level <= LARGEST { 1u64 << (3 * level) } else { 0 };
            found.extend((0..blocks).filter_map(|i| self.ask(witnesses, key | i, 3, &[octant.payload.value])));
        } else if level > 1 {
            self.open(place).iter().for_each(|child| self.descend(child, found));
        } else {
            // Who knows anything around a block is found out together with what it is.
            let blocks = self.field.tree().siblings(octant.link).iter().zip(0u64..).filter(|(octant, _)| octant.payload.max > 0);
            found.extend(blocks.filter_map(|(octant, i)| match octant.link {
                NONE => self.ask(witnesses, key | i, 3, &[octant.payload.value]),
                id => {
                    let block = self.field.block(id);
                    self.ask(witnesses, key | i, usize::from(block.scale), self.field.values(block))
                }
            }));
        }
    }

    /// The evidence that makes doubtful voxels of a block free, at the finest scale; none where nobody knows better.
    fn ask(&self, witnesses: &[&'a Witness<'a>], key: u64, scale: usize, values: &[i8]) -> Option<Evidence> {
        if !values.iter().any(|v| self.is_doubtful(*v)) {
            return None;
        }
        let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let testimony = Testimony::hear(witnesses, corner, 0.0, UNKNOWN);
        let mut beside: Option<Testimony<'_>> = None;
        let mut more: Option<Box<[i8]>> = None;
        let half = 0.5 * (1 << scale) as f32;
        for (i, &value) in values.iter().enumerate().filter(|(_, v)| self.is_doubtful(**v)) {
            let first = voxel_coords(i, scale).map(|c| c << scale);
            let centre: [f32; 3] = std::array::from_fn(|k| corner[k] + first[k] as f32 + half);
            // Most doubts are nobody else's business: one look tells.
            if i32::from(value) + testimony.evidence(centre) >= 0 {
                continue;
            }
            // What was seen from so far that only larger voxels told it apart gives way also beside a surface: that one is known better.
            if scale == 0 && beside.get_or_insert_with(|| Testimony::hear(witnesses, corner, BESIDE, self.most)).has_a_surface(centre, self.most) {
                continue;
            }
            for sub in 0..voxels_at(SCALES - 1 - scale) {
                let within = voxel_coords(sub, SCALES - 1 - scale);
                let c = [first[0] + within[0], first[1] + within[1], first[2] + within[2]];
                let evidence = testimony.evidence(std::array::from_fn(|k| corner[k] + c[k] as f32 + 0.5));
                if i32::from(value) + evidence < 0 {
                    more.get_or_insert_with(|| vec![UNKNOWN; voxels_at(0)].into())[voxel_index(c, 0)] = evidence.max(-127) as i8;
                }
            }
        }
        more.map(|more| (key, more))
    }
}

/// What the witnesses know in and around a block.
struct Testimony<'a> {
    /// Of those who say different things in different places.
    windows: Vec<(&'a Placement, Window<'a>)>,
    /// Sum of what the others say everywhere here.
    everywhere: i32,
}

impl<'a> Testimony<'a> {
    /// Of the block whose smallest corner is at `corner` and of `around` voxels about it, from those that hold more than `least` there.
    fn hear(witnesses: &[&'a Witness<'a>], corner: [f32; 3], around: f32, least: i8) -> Self {
        let half = 0.5 * BLOCK_EDGE as f32;
        let mut testimony = Self { windows: Vec::new(), everywhere: 0 };
        for w in witnesses {
            let blocks = Blocks::around(&w.placement, corner.map(|c| c + half), half + around);
            let Some(window) = Window::new(w.field, &blocks, least) else { continue };
            match window.uniform() {
                Some(value) if least == UNKNOWN => testimony.everywhere += i32::from(value),
                _ => testimony.windows.push((&w.placement, window)),
            }
        }
        testimony
    }

    /// Sum of what the witnesses hold at `p`, finest voxels of the doubtful submap.
    #[inline(always)]
    fn evidence(&self, p: [f32; 3]) -> i32 {
        let values = self.windows.iter().map(|(placement, window)| window.value(placement.t_source_target.apply(p)));
        self.everywhere + values.filter(|v| *v != UNKNOWN).map(i32::from).sum::<i32>()
    }

    /// Whether any of them has something occupied, no doubt of its own (`most`), around the finest voxel at `centre`.
    fn has_a_surface(&self, centre: [f32; 3], most: i8) -> bool {
        self.windows.iter().any(|(placement, window)| {
            let t = &placement.t_source_target;
            let reach = t.rotation.map(|row| row.iter().map(|r| r.abs()).sum::<f32>() * (0.5 + BESIDE) + MARGIN);
            let is_occupied = |[x, y, z]: [f32; 3]| window.value(t.apply([centre[0] + x, centre[1] + y, centre[2] + z])) > most;
            window.has_blocks_around(t.apply(centre), reach)
                && [0.5, 0.5 + 0.5 * BESIDE, 0.5 + BESIDE]
                    .into_iter()
                    .any(|r| (0..27).filter(|i| *i != 13).any(|i| is_occupied([i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1].map(|d| d as f32 * r))))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Doubts, LARGEST, Placement};
    use crate::atlas::fusion::{FusionSettings, settle_doubts};
    use crate::atlas::{Atlas, Submap};
    use crate::field::occupancy::{OccupancyField, State, UNKNOWN};
    use crate::geometry::Pose;
    use crate::octree::{Cursor, NONE, block_coords, block_key, voxel_coords, voxel_index, voxels_at};
    use crate::settings::Settings;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

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

    /// What the others say of a submap's doubtful voxels, each asked from the root up: the definition of [`Doubts`].
    fn slow(submap: &Submap, all: &[Submap], most: i8) -> BTreeMap<u64, Vec<i8>> {
        let others = all.iter().filter(|other| other.id != submap.id);
        let others: Vec<(&Submap, Placement)> =
            others.map(|other| (other, Placement::new(&submap.t_map_submap.inv_mul(&other.t_map_submap), VOXEL))).collect();
        let values = |p: [f32; 3]| {
            let value = |(other, t): &(&Submap, Placement)| other.occupancy.value_at(t.t_source_target.apply(p).map(|v| v.floor() as i32));
            others.iter().map(value).collect::<Vec<_>>()
        };
        let votes = |p| -> i32 { values(p).into_iter().filter(|v| *v != UNKNOWN).map(i32::from).sum() };
        let mut found = BTreeMap::new();
        let mut ask = |first: [i32; 3], edge: i32, value: i8| {
            let centre = first.map(|c| c as f32 + 0.5 * edge as f32);
            let outvoted = |p| i32::from(value) + votes(p) < 0;
            let at = |i: i32, r: f32| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1].map(|d| d as f32 * r);
            let is_wall = |i, r| values(std::array::from_fn(|k| centre[k] + at(i, r)[k])).into_iter().any(|v| v > most);
            if !(1..=most).contains(&value) || !outvoted(centre) {
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
            if octant.link == NONE && level <= LARGEST {
                (0..1 << (3 * level)).for_each(|i| ask(corner(key | i), 8, octant.payload.value));
            } else if octant.link != NONE && level == 0 {
                let block = submap.occupancy.block(octant.link);
                for (i, value) in submap.occupancy.values(block).iter().enumerate() {
                    let c = voxel_coords(i, block.scale.into());
                    ask(std::array::from_fn(|k| corner(key)[k] + (c[k] << block.scale) as i32), 1 << block.scale, *value);
                }
            }
        });
        found
    }

    /// Submaps of noise, turned and shifted against each other.
    fn noisy_atlas(seed: u64, turns: &[[f64; 3]], spread: f64, detail: u32) -> Atlas {
        let noise =
            |c: [i32; 3], salt: u64| c.iter().fold(seed ^ salt, |h, v| (h ^ *v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)) >> 50;
        let mut atlas = Atlas::default();
        for (w, &[roll, pitch, yaw]) in (0u64..).zip(turns) {
            // Cubes of one value, of two sizes, and here and there a surface, a hit, or nothing known.
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

    /// Finest voxels in doubt, and whether they are those that asking voxel by voxel finds.
    fn compare(atlas: &Atlas) -> (usize, bool) {
        let (mut count, mut is_equal) = (0, true);
        for (submap, doubts) in atlas.submaps().iter().zip(Doubts::of(atlas, VOXEL, 70)) {
            let doubts: BTreeMap<u64, Vec<i8>> = doubts.blocks.into_iter().map(|(key, more)| (key, more.into())).collect();
            let slow = slow(submap, atlas.submaps(), 70);
            count += slow.values().flatten().filter(|v| **v != UNKNOWN).count();
            is_equal &= doubts == slow;
        }
        (count, is_equal)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn doubts_are_those_that_asking_voxel_by_voxel_finds(
            seed in any::<u64>(), turns in prop::collection::vec(prop::array::uniform3(-3f64..3.0), 2..5), spread in 0f64..3.0, detail in 0u32..3,
        ) {
            prop_assert!(compare(&noisy_atlas(seed, &turns, spread, detail)).1);
        }
    }

    #[test]
    fn noise_leaves_doubts_to_be_found() {
        let (count, is_equal) = compare(&noisy_atlas(7, &[[0.4, -1.1, 2.0], [1.5, 0.3, -0.7], [-2.0, 1.0, 0.2]], 0.8, 1));
        assert!(is_equal && count > 100, "{count}");
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
