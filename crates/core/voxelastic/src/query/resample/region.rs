//! Which values a submap has around a cube of the map frame: they may be one value for the whole cube.

use super::super::atlas::PlacedField;
use super::super::shape::moved;
use crate::field::occupancy::{OccupancyField, State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, voxel_index};

/// Range of the known values in a region, and whether some of it is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ValueRange {
    least: i8,
    most: i8,
    unknown: bool,
}

impl ValueRange {
    pub const EMPTY: Self = Self { least: i8::MAX, most: i8::MIN, unknown: false };

    pub fn add(&mut self, value: i8) {
        if state_of(value) == State::Unknown {
            self.unknown = true;
        } else {
            (self.least, self.most) = (self.least.min(value), self.most.max(value));
        }
    }

    /// Whether no value is known.
    pub fn is_empty(&self) -> bool {
        self.least > self.most
    }

    /// The largest known value.
    pub fn most(&self) -> i8 {
        self.most
    }

    /// Whether all is free, with one value unless `states_only`.
    pub fn is_free(&self, states_only: bool) -> bool {
        !self.unknown && !self.is_empty() && self.most <= 0 && (self.least == self.most || states_only)
    }

    /// The value of a cube with these: occupied if some of it is, free if all of it is known.
    pub fn of_cube(&self) -> Option<i8> {
        (!self.is_empty() && (self.most > 0 || !self.unknown)).then_some(self.most)
    }
}

impl PlacedField<'_> {
    /// Values of the submap within a ball around a cube of the map frame; incomplete once one is occupied and, if only states matter, once some
    /// are known and some are not.
    pub(super) fn around(&self, middle: [f64; 3], radius: f64, states_only: bool) -> ValueRange {
        let mut known = ValueRange::EMPTY;
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
        let mut collect = Collect { field: self.query.field, bounds: [low, high], states_only, known };
        collect.octant(*tree.root(), root, tree.root_level());
        collect.known
    }
}

/// Collects the values of a field within a box, finest voxels.
struct Collect<'a> {
    field: &'a OccupancyField,
    bounds: [[f64; 3]; 2],
    states_only: bool,
    known: ValueRange,
}

impl Collect<'_> {
    fn octant(&mut self, octant: Octant<Summary>, corner: [i32; 3], level: u32) {
        let edge = 8 << level;
        let [low, high] = self.bounds;
        let summary = octant.payload;
        let is_mixed = self.states_only && self.known.unknown && !self.known.is_empty();
        let adds_nothing = self.known.most > 0 || (is_mixed && summary.max <= 0);
        if adds_nothing || (0..3).any(|k| f64::from(corner[k]) > high[k] || f64::from(corner[k] + edge) < low[k]) {
            return;
        }
        if octant.link == NONE {
            self.known.add(summary.value);
        } else if summary.max == UNKNOWN || (self.states_only && summary.observed && summary.max < 0) {
            self.known.add(summary.max);
        } else if level == 0 {
            self.block(octant.link, corner);
        } else {
            for (i, &child) in self.field.tree().siblings(octant.link).iter().enumerate() {
                let at = std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 });
                self.octant(child, at, level - 1);
            }
        }
    }

    fn block(&mut self, id: u32, corner: [i32; 3]) {
        let [low, high] = self.bounds;
        let block = self.field.block(id);
        let (values, scale) = (self.field.values(block), usize::from(block.scale));
        // Along each axis the voxels that touch the box.
        let within: [[bool; BLOCK_EDGE]; 3] = std::array::from_fn(|k| {
            std::array::from_fn(|c| {
                let first = f64::from(corner[k] + (c << scale) as i32);
                first <= high[k] && first + f64::from(1 << scale) >= low[k]
            })
        });
        let n = BLOCK_EDGE >> scale;
        for z in (0..n).filter(|&z| within[2][z]) {
            for y in (0..n).filter(|&y| within[1][y]) {
                for x in (0..n).filter(|&x| within[0][x]) {
                    self.known.add(values[voxel_index([x, y, z], scale)]);
                }
            }
        }
    }
}
