//! Occupancy fusion: log-odds of the source at the target's voxels are added; free space stays as coarse as in the source.

use super::occupancy_lookup::look_up;
use super::placement::{Placement, floor};
use crate::field::BlockStore;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::field::occupancy::{BlockBox, CellContent, OccupancyField, OccupancyWindow, Summary, UNKNOWN, state_of};
use crate::geometry::morton;
use crate::octree::{BLOCK_EDGE, Cursor, MAX_BLOCK_COORD, NONE, Octant, SCALES, block_coords, block_key, voxel_coords, voxel_index, voxels_at};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Level of the subtrees (32 blocks along an edge) that are sampled as one part.
const PART_LEVEL: u32 = 5;

/// Level of the cubes (4 blocks along an edge) around which the source is looked up at once.
const WINDOW_LEVEL: u32 = 2;

/// An octant or block of the target's lattice.
#[derive(Clone, Copy, Debug)]
enum PatchItem {
    /// A cube with one value: key of its first block, level.
    Uniform { key: u64, level: u32, value: i8 },
    /// A block with voxels.
    Block { key: u64, scale: u8, slot: u32 },
}

/// The source in the target's lattice, items in Morton order.
#[derive(Debug, Default)]
pub(super) struct OccupancyPatch {
    items: Vec<PatchItem>,
    voxels: BlockStore<i8>,
}

/// Values of the source in a box.
enum Content {
    /// One value.
    Uniform(i8),
    /// Several values; the finest scale among them, and whether both free and other space are among them.
    Mixed { finest: usize, is_border: bool },
}

impl OccupancyPatch {
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// A patch of blocks in any order; the scale of each follows from its number of values.
    pub fn of_blocks(blocks: &[(u64, Box<[i8]>)]) -> Self {
        let mut patch = Self::default();
        for (key, values) in blocks {
            let scale = (0..SCALES).find(|&scale| voxels_at(scale) == values.len()).unwrap_or(0);
            let slot = patch.voxels.insert(scale);
            patch.voxels.get_mut(scale, slot).copy_from_slice(values);
            patch.items.push(PatchItem::Block { key: *key, scale: scale as u8, slot });
        }
        patch
    }

    /// Adds items `range` to `target`; sums are clamped to `limits`.
    pub fn merge(&self, range: Range<usize>, target: &mut OccupancyField, limits: [i8; 2]) {
        for item in &self.items[range.clone()] {
            let (key, last) = match *item {
                PatchItem::Uniform { key, level, .. } => (key, key | ((1u64 << (3 * level)) - 1)),
                PatchItem::Block { key, .. } => (key, key),
            };
            target.tree.grow_to(key);
            target.tree.grow_to(last);
        }
        let mut adder = Adder { cursor: Cursor::new(&target.tree), limits, changed: ChangedOctants::default() };
        for item in &self.items[range] {
            match *item {
                PatchItem::Uniform { key, level, value } => adder.add_cube(target, key, level, value),
                PatchItem::Block { key, scale, slot } => {
                    adder.add_block(target, key, usize::from(scale), self.voxels.get(usize::from(scale), slot));
                }
            }
        }
        adder.changed.propagate_unlogged(target);
    }
}

/// Samples a field in the lattice of another one, part by part.
pub(super) struct OccupancySampling<'a> {
    source: &'a OccupancyField,
    placement: Placement,
    /// Cubes with observations, one per part.
    cubes: Arc<[Cube]>,
}

/// A cube of the target: key of its first block, level.
pub(super) type Cube = (u64, u32);

/// The target's cubes that the source has observations in.
pub(super) fn target_cubes(source: &OccupancyField, placement: &Placement) -> Arc<[Cube]> {
    if source.is_empty() {
        return Arc::default();
    }
    let sampling = OccupancySampling::new(source, placement, Arc::default());
    let mut cubes = sampling.top_cubes();
    while cubes.first().is_some_and(|c| c.1 > PART_LEVEL) {
        cubes = cubes.into_par_iter().flat_map_iter(|cube| sampling.children(cube)).collect();
    }
    cubes.into()
}

impl<'a> OccupancySampling<'a> {
    /// A sampling of `cubes`, which [`target_cubes`] found for the same source and placement.
    pub fn new(source: &'a OccupancyField, placement: &Placement, cubes: Arc<[Cube]>) -> Self {
        Self { source, placement: *placement, cubes }
    }

    /// Number of parts.
    pub fn len(&self) -> usize {
        self.cubes.len()
    }

    /// Samples part `number`.
    pub fn part(&self, number: usize) -> OccupancyPatch {
        let (key, level) = self.cubes[number];
        let mut patch = OccupancyPatch::default();
        self.descend(key, level, &mut patch);
        patch
    }

    /// Cubes of the source root's size that the source reaches.
    fn top_cubes(&self) -> Vec<Cube> {
        let tree = self.source.tree();
        let level = tree.root_level();
        let half = 0.5 * (BLOCK_EDGE << level) as f32;
        let centre = block_coords(tree.root_key()).map(|c| c as f32 * BLOCK_EDGE as f32 + half);
        let (middle, extent) = self.placement.box_in_target(centre, half);
        let corner = |sign: f32| {
            let c: [i32; 3] = std::array::from_fn(|k| ((middle[k] + sign * extent[k]) / BLOCK_EDGE as f32).floor() as i32);
            morton::decode(block_key(c.map(|v| v.clamp(-MAX_BLOCK_COORD, MAX_BLOCK_COORD)))).map(|v| v >> level)
        };
        let (low, high) = (corner(-1.0), corner(1.0));
        let mut cubes = Vec::new();
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    cubes.push((morton::encode([x, y, z]) << (3 * level), level));
                }
            }
        }
        cubes.sort_unstable();
        cubes
    }

    /// The eight children of a cube; none if the source has no observation there.
    fn children(&self, (key, level): Cube) -> Vec<Cube> {
        match self.content(key, level) {
            Content::Uniform(UNKNOWN) => Vec::new(),
            // A large uniform cube is divided here and becomes uniform again in the target.
            _ => (0..8).map(|i| (key | i << (3 * (level - 1)), level - 1)).collect(),
        }
    }

    fn descend(&self, key: u64, level: u32, patch: &mut OccupancyPatch) {
        if level <= WINDOW_LEVEL {
            let (centre, half) = centre_and_half(key, level);
            // None: the source has no observation there.
            if let Some(window) = OccupancyWindow::new(self.source, &self.placement.blocks_in_source(centre, half), UNKNOWN) {
                self.descend_in(&window, key, level, patch);
            }
            return;
        }
        match self.content(key, level) {
            Content::Uniform(UNKNOWN) => {}
            Content::Uniform(value) => patch.items.push(PatchItem::Uniform { key, level, value }),
            Content::Mixed { .. } => (0..8).for_each(|i| self.descend(key | i << (3 * (level - 1)), level - 1, patch)),
        }
    }

    /// As [`descend`](Self::descend), for a cube within the one that `window` is around.
    fn descend_in(&self, window: &OccupancyWindow<'_>, key: u64, level: u32, patch: &mut OccupancyPatch) {
        match self.content_in(window, key, level) {
            Content::Uniform(UNKNOWN) => {}
            Content::Uniform(value) => patch.items.push(PatchItem::Uniform { key, level, value }),
            Content::Mixed { .. } if level > 0 => {
                (0..8).for_each(|i| self.descend_in(window, key | i << (3 * (level - 1)), level - 1, patch));
            }
            Content::Mixed { finest, is_border } => self.sample_block(window, key, finest, is_border, patch),
        }
    }

    /// Samples a block. At the boundary of free space the scale is at most 1, so that free space does not grow.
    fn sample_block(&self, window: &OccupancyWindow<'_>, key: u64, finest: usize, is_border: bool, patch: &mut OccupancyPatch) {
        let scale = if is_border { finest.min(1) } else { finest };
        let mut values = [UNKNOWN; voxels_at(0)];
        let values = &mut values[..voxels_at(scale)];
        look_up(window, &self.placement, key, scale, values);
        if values.iter().any(|v| *v != values[0]) {
            let slot = patch.voxels.insert(scale);
            patch.voxels.get_mut(scale, slot).copy_from_slice(values);
            patch.items.push(PatchItem::Block { key, scale: scale as u8, slot });
        } else if values[0] != UNKNOWN {
            patch.items.push(PatchItem::Uniform { key, level: 0, value: values[0] });
        }
    }

    /// The box around a cube of the target in the source: its lowest and highest corner, finest voxels.
    fn box_in_source(&self, key: u64, level: u32) -> [[f32; 3]; 2] {
        let (centre, half) = centre_and_half(key, level);
        let (middle, extent) = self.placement.box_in_source(centre, half);
        [std::array::from_fn(|k| middle[k] - extent[k]), std::array::from_fn(|k| middle[k] + extent[k])]
    }

    /// Values of the source in the box around a cube of the target.
    fn content(&self, key: u64, level: u32) -> Content {
        let [low, high] = self.box_in_source(key, level);
        let tree = self.source.tree();
        let mut found = Values::default();
        let root_edge = (BLOCK_EDGE << tree.root_level()) as f32;
        let root_corner = block_coords(tree.root_key()).map(|c| c as f32 * BLOCK_EDGE as f32);
        if (0..3).any(|k| low[k] < root_corner[k] || high[k] > root_corner[k] + root_edge) {
            found.add(UNKNOWN);
        }
        touched_blocks(low, high).visit_leaves(self.source, &mut |_| true, &mut |leaf| {
            match leaf.octant.link {
                NONE => found.add(leaf.octant.payload.value),
                id => found.add_block(usize::from(self.source.block(id).scale)),
            }
            found.is_enough(level)
        });
        found.content()
    }

    /// As [`content`](Self::content), for a cube within the one that `window` is around. What is outside of the source's root is unknown there, too.
    fn content_in(&self, window: &OccupancyWindow<'_>, key: u64, level: u32) -> Content {
        let [low, high] = self.box_in_source(key, level);
        let mut found = Values::default();
        window.visit(&touched_blocks(low, high), |cell| {
            match cell {
                CellContent::Uniform(value) => found.add(value),
                CellContent::Block(scale) => found.add_block(scale),
            }
            found.is_enough(level)
        });
        found.content()
    }
}

/// Centre of a cube of the target and half of its edge, finest voxels.
fn centre_and_half(key: u64, level: u32) -> ([f32; 3], f32) {
    let half = 0.5 * (BLOCK_EDGE << level) as f32;
    (block_coords(key).map(|c| c as f32 * BLOCK_EDGE as f32 + half), half)
}

/// The blocks that overlap a box by more than a face.
fn touched_blocks(low: [f32; 3], high: [f32; 3]) -> BlockBox {
    BlockBox::of_voxels(low.map(floor), high.map(|c| -floor(-c) - 1))
}

/// The values that were found in a box.
#[derive(Default)]
struct Values {
    /// The first value of a uniform octant.
    first: Option<i8>,
    /// Set once there are several values: the finest scale, and whether both free and other space were found.
    mixed: Option<(usize, bool)>,
}

impl Values {
    /// Whether no more values are needed of a cube at `level`. A single block is searched to its end: its finest scale counts.
    fn is_enough(&self, level: u32) -> bool {
        self.mixed.is_some() && level > 0
    }

    /// What was found, which does not depend on the order in which it was added.
    fn content(&self) -> Content {
        match (self.mixed, self.first) {
            (Some((finest, is_border)), _) => Content::Mixed { finest, is_border },
            (None, value) => Content::Uniform(value.unwrap_or(UNKNOWN)),
        }
    }

    /// Adds a uniform octant.
    fn add(&mut self, value: i8) {
        let first = *self.first.get_or_insert(value);
        if first != value {
            let (finest, is_border) = self.mixed.unwrap_or((SCALES - 1, false));
            self.mixed = Some((finest, is_border || state_of(first) != state_of(value)));
        }
    }

    /// Adds a block, which is never uniform, even if its voxels within the box are.
    fn add_block(&mut self, scale: usize) {
        let (finest, is_border) = self.mixed.unwrap_or((scale, false));
        self.mixed = Some((finest.min(scale), is_border));
    }
}

/// Adds log-odds to a field.
struct Adder {
    cursor: Cursor,
    limits: [i8; 2],
    changed: ChangedOctants,
}

impl Adder {
    fn sum(&self, value: i8, more: i8) -> i8 {
        match (value, more) {
            (value, UNKNOWN) => value,
            (UNKNOWN, more) => more.clamp(self.limits[0], self.limits[1]),
            (value, more) => (i16::from(value) + i16::from(more)).clamp(i16::from(self.limits[0]), i16::from(self.limits[1])) as i8,
        }
    }

    /// Adds `more` to all of a cube.
    fn add_cube(&mut self, field: &mut OccupancyField, key: u64, level: u32, more: i8) {
        if level >= field.tree.root_level() {
            (0..8).for_each(|i| self.add_cube(field, key | i << (3 * (level - 1)), level - 1, more));
            return;
        }
        let (group, child) = self.cursor.find_or_create_at(&mut field.tree, key, level);
        self.add_below(field, key, level, (group, child), more);
    }

    fn add_below(&mut self, field: &mut OccupancyField, key: u64, level: u32, (group, child): (u32, usize), more: i8) {
        let octant = field.tree.siblings(group)[child];
        if octant.link == NONE {
            field.tree.siblings_mut(group)[child].payload = Summary::uniform(self.sum(octant.payload.value, more));
            self.changed.add(key, level);
        } else if level == 0 {
            self.update(field, octant.link, |_| more);
        } else {
            for i in 0..8 {
                self.add_below(field, key | (i as u64) << (3 * (level - 1)), level - 1, (octant.link, i), more);
            }
        }
    }

    /// Adds a block's voxels.
    fn add_block(&mut self, field: &mut OccupancyField, key: u64, scale: usize, values: &[i8]) {
        let id = field.find_or_create(&mut self.cursor, key, scale);
        let target_scale = usize::from(field.block(id).scale);
        let index = |i: usize| voxel_index(voxel_coords(i, target_scale).map(|c| c >> (scale - target_scale)), scale);
        self.update(field, id, |i| values[index(i)]);
    }

    /// Adds `more(voxel)` to each voxel of block `id`; removes the block if that makes it uniform.
    fn update(&mut self, field: &mut OccupancyField, id: u32, more: impl Fn(usize) -> i8) {
        let block = *field.block(id);
        let (mut low, mut high) = (i8::MAX, i8::MIN);
        for (i, value) in field.voxels.get_mut(usize::from(block.scale), block.slot).iter_mut().enumerate() {
            *value = self.sum(*value, more(i));
            low = low.min(*value);
            high = high.max(*value);
        }
        let (group, child) = self.cursor.find_or_create(&mut field.tree, block.key);
        if low == high {
            field.remove(id);
            field.tree.siblings_mut(group)[child] = Octant { link: NONE, payload: Summary::uniform(low) };
        } else {
            field.tree.siblings_mut(group)[child].payload = Summary { value: UNKNOWN, max: high, observed: low != UNKNOWN };
        }
        self.changed.add(block.key, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use proptest::prelude::*;

    /// A field of blocks around its origin, each with one of some values everywhere or with voxels at a scale of its own.
    fn field(edge: i32, noise: impl Fn([i32; 3]) -> u64) -> OccupancyField {
        let mut field = OccupancyField::default();
        let value = |n: u64| [UNKNOWN, -64, -64, -16, 0, 70][n as usize % 6];
        let mut blocks = Vec::new();
        for i in 0..edge.pow(3) {
            let block = [i % edge - edge / 2, i / edge % edge - edge / 2, i / (edge * edge) - edge / 2];
            let own = noise(block);
            // Eight blocks in one of three pieces of space are alike.
            let around = noise(block.map(|c| 1000 + (c >> 1)));
            let (is_uniform, of_all) = if around.is_multiple_of(3) { (true, around / 3) } else { (own.is_multiple_of(2), own / 8) };
            let voxel = |v: usize| value(if is_uniform { of_all } else { noise([v as i32, block[0], block[1] + 99 * block[2]]) });
            let values = (0..voxels_at((own / 2 % 4) as usize)).map(voxel);
            blocks.push((block_key(block), values.collect()));
        }
        let patch = OccupancyPatch::of_blocks(&blocks);
        patch.merge(0..patch.len(), &mut field, [-64, 112]);
        field
    }

    impl OccupancySampling<'_> {
        /// As [`descend`](Self::descend): all of a cube looked up from the root, voxel by voxel.
        fn slow(&self, key: u64, level: u32, found: &mut Vec<(u64, u32, Vec<i8>)>) {
            match self.content(key, level) {
                Content::Uniform(UNKNOWN) => {}
                Content::Uniform(value) => found.push((key, level, vec![value])),
                Content::Mixed { .. } if level > 0 => (0..8).for_each(|i| self.slow(key | i << (3 * (level - 1)), level - 1, found)),
                Content::Mixed { finest, is_border } => {
                    let scale = if is_border { finest.min(1) } else { finest };
                    let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
                    let value = |i: usize| {
                        let c = voxel_coords(i, scale);
                        let centre = std::array::from_fn(|k| corner[k] + (c[k] as f32 + 0.5) * (1 << scale) as f32);
                        self.source.value_at(self.placement.t_source_target.apply(centre).map(|v| v.floor() as i32))
                    };
                    let values: Vec<i8> = (0..voxels_at(scale)).map(value).collect();
                    match values.iter().any(|v| *v != values[0]) {
                        true => found.push((key, 0, values)),
                        false => found.extend((values[0] != UNKNOWN).then(|| (key, 0, vec![values[0]]))),
                    }
                }
            }
        }
    }

    fn items(patch: &OccupancyPatch) -> Vec<(u64, u32, Vec<i8>)> {
        let item = |item: &PatchItem| match *item {
            PatchItem::Uniform { key, level, value } => (key, level, vec![value]),
            PatchItem::Block { key, scale, slot } => (key, 0, patch.voxels.get(scale.into(), slot).to_vec()),
        };
        patch.items.iter().map(item).collect()
    }

    /// Number of blocks and of cubes of several blocks in the samples of a field, and whether all equal those found voxel by voxel.
    fn compare(seed: u64, edge: i32, angles: [f64; 3], shift: [f64; 3]) -> (usize, usize, bool) {
        let noise = |c: [i32; 3]| c.iter().fold(seed, |h, v| (h ^ *v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)) >> 40;
        let source = field(edge, noise);
        let placement = Placement::new(&Pose::new(shift.into(), angles.into()), 1.0);
        let sampling = OccupancySampling::new(&source, &placement, target_cubes(&source, &placement));
        let (mut blocks, mut cubes, mut is_equal) = (0, 0, true);
        for number in 0..sampling.len() {
            let found = items(&sampling.part(number));
            let mut slow = Vec::new();
            let (key, level) = sampling.cubes[number];
            sampling.slow(key, level, &mut slow);
            is_equal &= found == slow;
            blocks += found.iter().filter(|(.., values)| values.len() > 1).count();
            cubes += found.iter().filter(|(_, level, _)| *level > 0).count();
        }
        (blocks, cubes, is_equal)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn samples_equal_those_looked_up_voxel_by_voxel(
            seed in any::<u64>(), edge in 1i32..9, angles in prop_oneof![Just([0.0; 3]), prop::array::uniform3(-3f64..3.0)],
            shift in prop_oneof![Just([0.0; 3]), prop::array::uniform3(-99f64..99.0)],
        ) {
            prop_assert!(compare(seed, edge, angles, shift).2);
        }
    }

    #[test]
    fn samples_have_blocks_and_cubes() {
        let (blocks, _, is_equal) = compare(3, 8, [0.1, -0.2, 2.0], [3.0, -9.0, 1.5]);
        let (_, cubes, is_equal_too) = compare(3, 8, [0.0; 3], [0.0; 3]);
        assert!(blocks > 100 && cubes > 5 && is_equal && is_equal_too, "{blocks} blocks, {cubes} cubes");
    }
}
