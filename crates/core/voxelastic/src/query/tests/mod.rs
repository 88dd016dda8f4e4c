//! Queries against brute force over every leaf of random fields.

mod atlas;
mod merge;
mod single;

use crate::field::occupancy::{OccupancyField, State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_SHIFT, Cursor, NONE, Octant, block_coords, block_key, voxel_coords, voxels_at};
use crate::query::*;
use proptest::prelude::*;

const VOXEL: f32 = 0.125;

/// A leaf: smallest corner and edge in finest voxels, value.
#[derive(Clone, Copy, Debug)]
struct Leaf {
    low: [i32; 3],
    edge: i32,
    value: i8,
}

impl Leaf {
    fn corners(&self) -> ([f32; 3], [f32; 3]) {
        (self.low.map(|c| c as f32), self.low.map(|c| (c + self.edge) as f32))
    }
}

struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    /// Mostly free, else anything; `rare` is one in how many.
    fn value(&mut self, rare: u64) -> i8 {
        if self.below(rare) > 0 { -1 - self.below(64) as i8 } else { [UNKNOWN, 0, 1, 27, 112][self.below(5) as usize] }
    }
}

/// A field of octants and blocks of all sizes, `rare` as in [`Numbers::value`].
fn random_field(seed: u64, rare: u64) -> OccupancyField {
    let mut numbers = Numbers(seed);
    let mut field = OccupancyField::default();
    [[-2, -2, -2], [1, 1, 1]].into_iter().for_each(|c| field.tree.grow_to(block_key(c)));
    let (key, level) = (field.tree.root_key(), field.tree.root_level());
    fill(&mut field, &mut numbers, rare, key, level);
    summarise(&mut field, level, key);
    field
}

fn fill(field: &mut OccupancyField, numbers: &mut Numbers, rare: u64, key: u64, level: u32) {
    let mut cursor = Cursor::new(&field.tree);
    if level == 0 && numbers.below(3) > 0 {
        let scale = numbers.below(3) as usize;
        let id = field.find_or_create(&mut cursor, key, scale);
        let values: Vec<i8> = (0..voxels_at(scale)).map(|_| numbers.value(8 * rare)).collect();
        let block = *field.block(id);
        field.voxels.get_mut(scale, block.slot).copy_from_slice(&values);
    } else if level == 0 || (level < field.tree.root_level() && numbers.below(4) == 0) {
        let (group, place) = cursor.find_or_create_at(&mut field.tree, key, level);
        field.tree.siblings_mut(group)[place].payload = Summary::uniform(numbers.value(rare));
    } else {
        (0..8u64).for_each(|i| fill(field, numbers, rare, key | i << (3 * (level - 1)), level - 1));
    }
}

/// Sets the summaries of everything with something below.
fn summarise(field: &mut OccupancyField, level: u32, key: u64) -> Summary {
    let octant: Octant<Summary> = match field.tree.octant_mut(key, level) {
        Some(octant) => *octant,
        None => return Summary::uniform(UNKNOWN),
    };
    if octant.link == NONE {
        return octant.payload;
    }
    let summary = if level == 0 {
        let values = field.values(field.block(octant.link));
        Summary::of(values.iter().map(|&v| Summary::uniform(v)))
    } else {
        Summary::of((0..8u64).map(|i| summarise(field, level - 1, key | i << (3 * (level - 1)))).collect::<Vec<_>>().into_iter())
    };
    if let Some(octant) = field.tree.octant_mut(key, level) {
        octant.payload = summary;
    }
    summary
}

fn leaves(field: &OccupancyField) -> Vec<Leaf> {
    let mut leaves = Vec::new();
    field.tree.for_each(|key, level, octant| {
        let corner = block_coords(key).map(|c| c << BLOCK_SHIFT);
        if octant.link == NONE {
            leaves.push(Leaf { low: corner, edge: 8 << level, value: octant.payload.value });
        } else if level == 0 {
            let block = field.block(octant.link);
            let scale = usize::from(block.scale);
            leaves.extend(field.values(block).iter().enumerate().map(|(i, &value)| {
                let c = voxel_coords(i, scale);
                Leaf { low: std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), edge: 1 << scale, value }
            }));
        }
    });
    leaves
}

/// The root cube in finest voxels.
fn root(field: &OccupancyField) -> Leaf {
    Leaf { low: block_coords(field.tree.root_key()).map(|c| c << BLOCK_SHIFT), edge: 8 << field.tree.root_level(), value: UNKNOWN }
}

fn policy() -> impl Strategy<Value = UnknownAs> {
    prop_oneof![Just(UnknownAs::Blocked), Just(UnknownAs::Free)]
}

/// A random pose near the origin.
fn pose() -> impl Strategy<Value = crate::Pose> {
    (prop::array::uniform3(-1.0..1.0f64), prop::array::uniform3(-3.0..3.0f64))
        .prop_map(|(t, r)| crate::Pose::from_parts(t.into(), nalgebra::UnitQuaternion::from_euler_angles(r[0], r[1], r[2])))
}

/// A random shape of up to about a metre in the middle of the field, metres.
fn shape() -> impl Strategy<Value = Shape> {
    let point = || prop::array::uniform3(-1.7..1.7f64);
    prop_oneof![
        (point(), 0.0..0.9f64).prop_map(|(centre, radius)| Sphere { centre, radius }.into()),
        (point(), prop::array::uniform3(-0.8..0.8f64), 0.0..0.4f64)
            .prop_map(|(from, by, radius)| { Capsule { from, to: std::array::from_fn(|k| from[k] + by[k]), radius }.into() }),
        (pose(), prop::array::uniform3(0.0..0.6f64)).prop_map(|(t_frame_box, half)| OrientedBox { t_frame_box, half }.into()),
    ]
}

/// A random ray through the field, metres.
fn ray() -> impl Strategy<Value = Ray> {
    let direction = prop_oneof![
        4 => prop::array::uniform3(-1.0..1.0f64),
        1 => prop::sample::select(vec![[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 2.0], [0.0, 1.0, 1.0]]),
    ];
    (prop::array::uniform3(-2.2..2.2f64), direction, 0.0..6.0f64).prop_map(|(origin, direction, length)| Ray { origin, direction, length })
}

/// Where a normalised ray enters and leaves a leaf grown by `by` voxels, in voxels.
fn slab(ray: &Ray, leaf: &Leaf, by: f64) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
    for k in 0..3 {
        let (low, high) = (f64::from(leaf.low[k]) - by, f64::from(leaf.low[k] + leaf.edge) + by);
        let origin = ray.origin[k] / f64::from(VOXEL);
        if ray.direction[k] == 0.0 {
            if origin < low || origin > high {
                return None;
            }
        } else {
            let (a, b) = ((low - origin) / ray.direction[k], (high - origin) / ray.direction[k]);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    (enter < leave).then_some((enter, leave))
}
