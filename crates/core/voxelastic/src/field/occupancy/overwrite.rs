//! Other values for what was observed in a part of space, as by somebody who edits a map.

use super::field::OccupancyField;
use super::propagate::ChangedOctants;
use super::value::{Summary, UNKNOWN};
use crate::octree::{BLOCK_EDGE, Cursor, NONE, Octant, block_coords, voxel_coords, voxels_at};

/// Half the diagonal of a cube of edge 1, and a little for rounding.
const HALF_DIAGONAL: f64 = 0.867;

/// An octant or a block with new values.
enum Item {
    /// A cube that had one value and has another: key of its first block, level.
    Uniform { key: u64, level: u32, value: i8 },
    /// A block: all of its voxels at this scale.
    Block { key: u64, scale: usize, values: Box<[i8]> },
}

/// Looks for what changes.
struct Search<'a, D, C> {
    field: &'a OccupancyField,
    distance: &'a D,
    change: &'a C,
    items: Vec<Item>,
    /// Finest voxels whose value changes.
    voxels: u64,
}

impl OccupancyField {
    /// Changes the values of the voxels whose centres are in a region by `change`; returns of how many finest voxels the value is another one then.
    ///
    /// `distance` is the distance of a point (finest voxels) to the border of the region, negative in it, or anything nearer to zero.
    pub(crate) fn overwrite(&mut self, distance: &impl Fn([f64; 3]) -> f64, change: &impl Fn(i8) -> i8) -> u64 {
        if self.is_empty() {
            return 0;
        }
        let mut search = Search { field: self, distance, change, items: Vec::new(), voxels: 0 };
        search.descend(self.tree.root(), self.tree.root_key(), self.tree.root_level());
        let Search { items, voxels, .. } = search;
        let mut changed = ChangedOctants::default();
        let mut cursor = Cursor::new(&self.tree);
        for item in items {
            match item {
                Item::Uniform { key, level, value } => {
                    let (group, child) = cursor.find_or_create_at(&mut self.tree, key, level);
                    self.tree.siblings_mut(group)[child].payload = Summary::uniform(value);
                    changed.add(key, level);
                }
                Item::Block { key, scale, values } => {
                    self.put_block(&mut cursor, key, scale, &values);
                    changed.add(key, 0);
                }
            }
        }
        changed.propagate_unlogged(self);
        voxels
    }

    /// Makes `values`, at `scale`, those of block `key`, which is as coarse or does not exist. Values that are all the same need no block.
    fn put_block(&mut self, cursor: &mut Cursor, key: u64, scale: usize, values: &[i8]) {
        let id = self.find_or_create(cursor, key, scale);
        let (group, child) = cursor.find_or_create(&mut self.tree, key);
        let (low, high) = values.iter().fold((i8::MAX, i8::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
        if low == high {
            self.remove(id);
            self.tree.siblings_mut(group)[child] = Octant { link: NONE, payload: Summary::uniform(low) };
        } else {
            let block = *self.block(id);
            self.voxels.get_mut(scale, block.slot).copy_from_slice(values);
            self.tree.siblings_mut(group)[child].payload = Summary { value: UNKNOWN, max: high, observed: low != UNKNOWN };
        }
    }
}

impl<D: Fn([f64; 3]) -> f64, C: Fn(i8) -> i8> Search<'_, D, C> {
    fn descend(&mut self, octant: &Octant<Summary>, key: u64, level: u32) {
        let edge = (BLOCK_EDGE << level) as f64;
        let distance = (self.distance)(block_coords(key).map(|c| f64::from(c) * BLOCK_EDGE as f64 + 0.5 * edge));
        if distance > HALF_DIAGONAL * edge {
            return;
        }
        let is_inside = distance < -HALF_DIAGONAL * edge;
        let (link, value) = (octant.link, octant.payload.value);
        if link == NONE && (self.change)(value) == value {
            return;
        }
        match (link, level) {
            (NONE, _) if is_inside && level < self.field.tree.root_level() => {
                self.items.push(Item::Uniform { key, level, value: (self.change)(value) });
                self.voxels += (voxels_at(0) as u64) << (3 * level);
            }
            (NONE, 0) => self.block(key, 0, &[value; voxels_at(0)], false),
            (NONE, _) => (0..8).for_each(|i| self.descend(octant, key | i << (3 * (level - 1)), level - 1)),
            (id, 0) => {
                let (field, block) = (self.field, self.field.block(id));
                self.block(key, usize::from(block.scale), field.values(block), is_inside);
            }
            (group, _) => {
                let children = self.field.tree.siblings(group);
                (0..8).for_each(|i| self.descend(&children[i as usize], key | i << (3 * (level - 1)), level - 1));
            }
        }
    }

    fn block(&mut self, key: u64, scale: usize, values: &[i8], is_inside: bool) {
        let corner = block_coords(key).map(|c| f64::from(c) * BLOCK_EDGE as f64);
        let centre = |i: usize| {
            let c = voxel_coords(i, scale);
            std::array::from_fn(|k| corner[k] + (c[k] as f64 + 0.5) * f64::from(1u32 << scale))
        };
        let mut changed = 0;
        let new = |(i, value): (usize, &i8)| {
            let to = (self.change)(*value);
            let changes = to != *value && (is_inside || (self.distance)(centre(i)) < 0.0);
            changed += u64::from(changes);
            if changes { to } else { *value }
        };
        let values: Box<[i8]> = values.iter().enumerate().map(new).collect();
        if changed > 0 {
            self.voxels += changed << (3 * scale);
            self.items.push(Item::Block { key, scale, values });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{block_key, voxel_index};
    use proptest::prelude::*;

    const EDGE: i32 = 6;

    /// A field around its origin of blocks, large cubes and unknown space.
    fn field(seed: u64) -> OccupancyField {
        let mut number = seed;
        let mut next = move || {
            number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (number >> 40) as usize
        };
        let value = |n: usize| [UNKNOWN, -64, -64, 5, 70][n % 5];
        let mut field = OccupancyField::default();
        let keys: Vec<u64> =
            (0..EDGE.pow(3)).map(|i| block_key([i % EDGE - EDGE / 2, i / EDGE % EDGE - EDGE / 2, i / (EDGE * EDGE) - EDGE / 2])).collect();
        field.tree.grow_over(keys.iter().copied());
        let (mut cursor, mut changed) = (Cursor::new(&field.tree), ChangedOctants::default());
        let of_groups = [next(), next(), next()];
        for key in keys {
            let (scale, own) = (next() % 4, next());
            let alike = own % 3 > 0;
            let of_group = value(of_groups[(key >> 3) as usize % 3]);
            let values: Vec<i8> = (0..voxels_at(scale)).map(|_| if alike { of_group } else { value(next()) }).collect();
            field.put_block(&mut cursor, key, scale, &values);
            changed.add(key, 0);
        }
        changed.propagate_unlogged(&mut field);
        field
    }

    /// All octants in order must be what their subtrees say.
    fn check_summaries(field: &OccupancyField, octant: &Octant<Summary>, level: u32) -> Summary {
        let expected = match (octant.link, level) {
            (NONE, _) => Summary::uniform(octant.payload.value),
            (id, 0) => {
                let values = field.values(field.block(id));
                assert!(values.iter().any(|v| *v != values[0]), "a uniform block");
                Summary::of(values.iter().map(|v| Summary::uniform(*v)))
            }
            (group, _) => {
                let children = field.tree.siblings(group);
                let below: Vec<Summary> = children.iter().map(|child| check_summaries(field, child, level - 1)).collect();
                assert!(!(children.iter().all(|c| c.link == NONE) && below.iter().all(|s| *s == below[0])) || level == field.tree.root_level());
                Summary::of(below.into_iter())
            }
        };
        assert_eq!((expected.max, expected.observed), (octant.payload.max, octant.payload.observed), "level {level}");
        expected
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn every_voxel_is_as_the_region_says(seed in any::<u64>(), centre in prop::array::uniform3(-30.0..30.0f64), radius in 1.0..40.0f64,
            is_outside in any::<bool>(), frees in any::<bool>()) {
            let before = field(seed);
            let mut after = before.clone();
            let sign = if is_outside { -1.0 } else { 1.0 };
            let distance = |p: [f64; 3]| sign * ((0..3).map(|k| (p[k] - centre[k]).powi(2)).sum::<f64>().sqrt() - radius);
            let change = |v: i8| if !frees { UNKNOWN } else if v > 0 { -64 } else { v };
            let count = after.overwrite(&distance, &change);
            let (mut expected_count, low, high) = (0, -4 * EDGE, 4 * EDGE);
            for z in low..high { for y in low..high { for x in low..high {
                let c = [x, y, z];
                let leaf = before.leaf_at(c).unwrap();
                // What a voxel of a block is asked for is its own centre; large cubes are divided.
                let edge = if leaf.edge_log2 < 3 && !is_of_cube(&before, c) { 1 << leaf.edge_log2 } else { 1 };
                let at = c.map(|v| f64::from(v.div_euclid(edge) * edge) + 0.5 * f64::from(edge));
                let expected = if distance(at) < 0.0 { change(leaf.value) } else { leaf.value };
                expected_count += u64::from(expected != leaf.value);
                prop_assert_eq!(after.value_at(c), expected, "{:?}", c);
            } } }
            let outside = count - expected_count;
            prop_assert!(outside == 0, "{} counted too many", outside);
            check_summaries(&after, after.tree.root(), after.tree.root_level());
        }
    }

    fn is_of_cube(field: &OccupancyField, c: [i32; 3]) -> bool {
        field.tree.block(block_key(c.map(|v| v >> 3))).is_none()
    }

    #[test]
    fn nothing_of_an_empty_field_changes() {
        assert_eq!(OccupancyField::default().overwrite(&|_| -1.0, &|_| UNKNOWN), 0);
        let mut field = field(3);
        assert_eq!(field.overwrite(&|_| 1e9, &|_| UNKNOWN), 0);
        assert!(field.overwrite(&|_| -1e9, &|_| UNKNOWN) > 0);
        assert!((0..512).all(|i| field.value_at(voxel_coords(i, 0).map(|c| c as i32)) == UNKNOWN) && field.is_empty() == field.tree.is_empty());
        assert_eq!(voxel_index([0, 0, 0], 0), 0);
    }
}
