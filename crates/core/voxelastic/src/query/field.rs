//! Queries on one field in the submap frame: points and cubes.

use super::UnknownAs;
use super::shape::moved;
use crate::field::occupancy::{OccupancyField, State, Summary, UNKNOWN, log_odds, state_of};
use crate::geometry::{Aabb, Pose};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, block_coords, block_key, voxel_coords};

/// Queries one occupancy field. Coordinates are metres in the submap frame.
#[derive(Clone, Copy, Debug)]
pub struct FieldQuery<'a> {
    pub(super) field: &'a OccupancyField,
    pub(super) voxel: f64,
    pub(super) per_metre: f64,
}

/// Summary of a cube of space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellSummary {
    /// Largest value in the cube, steps of log-odds; [`UNKNOWN`] if no voxel was observed.
    pub max: i8,
    /// Whether all voxels of the cube were observed.
    pub observed: bool,
}

impl CellSummary {
    /// A cube without observations.
    pub const UNKNOWN: Self = Self { max: UNKNOWN, observed: false };

    /// Occupied if any voxel in the cube is, free if all are.
    pub fn state(&self) -> State {
        if self.max > 0 {
            State::Occupied
        } else if self.observed && self.max < 0 {
            State::Free
        } else {
            State::Unknown
        }
    }

    /// Largest log-odds in the cube; none if no voxel was observed.
    pub fn log_odds(&self) -> Option<f32> {
        log_odds(self.max)
    }

    fn add(&mut self, value: i8) {
        self.max = self.max.max(value);
        self.observed &= value != UNKNOWN;
    }
}

impl From<Summary> for CellSummary {
    fn from(summary: Summary) -> Self {
        Self { max: summary.max, observed: summary.observed }
    }
}

/// Whether a voxel of this value blocks robots and rays.
#[inline(always)]
pub(super) fn blocks(value: i8, unknown: UnknownAs) -> bool {
    match unknown {
        UnknownAs::Blocked => state_of(value) != State::Free,
        UnknownAs::Free => state_of(value) == State::Occupied,
    }
}

/// Whether no voxel of an octant blocks robots and rays.
#[inline(always)]
pub(super) fn is_clear(summary: &Summary, unknown: UnknownAs) -> bool {
    match unknown {
        UnknownAs::Blocked => summary.observed && summary.max < 0,
        UnknownAs::Free => summary.max <= 0,
    }
}

impl<'a> FieldQuery<'a> {
    /// Queries on `field`, whose finest voxels have edges of `voxel_size` metres.
    pub(crate) fn new(field: &'a OccupancyField, voxel_size: f32) -> Self {
        let voxel = f64::from(voxel_size);
        Self { field, voxel, per_metre: 1.0 / voxel }
    }

    /// Coordinates of the finest voxel that contains `p`; none if `p` is beyond the largest coordinates of a field or not finite.
    pub(super) fn voxel_of(&self, p: [f64; 3]) -> Option<[i32; 3]> {
        const LIMIT: f64 = ((crate::octree::MAX_BLOCK_COORD as i64) << BLOCK_SHIFT) as f64;
        let c = p.map(|c| (c * self.per_metre).floor());
        c.iter().all(|v| v.abs() <= LIMIT).then(|| c.map(|v| v as i32))
    }

    /// Value at `p`, steps; [`UNKNOWN`] outside of the field.
    pub(super) fn value(&self, p: [f64; 3]) -> i8 {
        self.voxel_of(p).map_or(UNKNOWN, |c| self.field.value_at(c))
    }

    /// State of the voxel at `p`.
    pub fn state(&self, p: [f64; 3]) -> State {
        state_of(self.value(p))
    }

    /// Log-odds of occupancy of the voxel at `p`; none if it was not observed.
    pub fn log_odds(&self, p: [f64; 3]) -> Option<f32> {
        log_odds(self.value(p))
    }

    /// Summary of the cube of 2^level finest voxels around `p`: cubes of one level tile the submap frame, as octants do.
    pub fn at_level(&self, p: [f64; 3], level: u32) -> CellSummary {
        let Some(c) = self.voxel_of(p) else { return CellSummary::UNKNOWN };
        let tree = self.field.tree();
        let key = block_key(c.map(|v| v >> BLOCK_SHIFT));
        let lowest = level.saturating_sub(BLOCK_SHIFT);
        if lowest > tree.root_level() {
            // A cube larger than the root contains all of it or none, and unknown space.
            let above = (3 * lowest).min(u64::BITS - 1);
            let contains_root = !tree.is_empty() && key >> above == tree.root_key() >> above;
            return if contains_root { CellSummary { observed: false, ..tree.root().payload.into() } } else { CellSummary::UNKNOWN };
        }
        match self.field.tree().find_at_least(key, lowest) {
            Some((0, octant)) if octant.link != NONE && level < BLOCK_SHIFT => self.summary_in_block(octant.link, c, level as usize),
            Some((_, octant)) => octant.payload.into(),
            None => CellSummary::UNKNOWN,
        }
    }

    /// Summary of the cube of 2^level voxels, smaller than the block, that contains voxel `c`.
    fn summary_in_block(&self, link: u32, c: [i32; 3], level: usize) -> CellSummary {
        let block = self.field.block(link);
        let (values, scale) = (self.field.values(block), usize::from(block.scale));
        let cube = |c: [usize; 3]| c.map(|v| v >> level);
        let at = cube(c.map(|v| v as usize & (BLOCK_EDGE - 1)));
        let mut summary = CellSummary { max: UNKNOWN, observed: true };
        for (i, &value) in values.iter().enumerate() {
            let low = voxel_coords(i, scale).map(|v| v << scale);
            let is_in = cube(low) == at || (scale > level && (0..3).all(|k| at[k] << level >> scale == low[k] >> scale));
            if is_in {
                summary.add(value);
            }
        }
        summary
    }

    /// Box around everything observed, metres in the submap frame; empty if nothing was.
    pub fn bounds(&self) -> Aabb {
        *self.field.changes.bounds.get_or_init(|| self.bounds_in(&Pose::identity()))
    }

    /// Box around all observed octants in the frame that `t_frame_submap` maps to; empty if there are none.
    pub fn bounds_in(&self, t_frame_submap: &Pose) -> Aabb {
        let tree = self.field.tree();
        let mut bounds = Aabb::default();
        if tree.is_empty() {
            return bounds;
        }
        let rotation = t_frame_submap.rotation.to_rotation_matrix();
        // Half extents of a rotated block.
        let reach: [f64; 3] = std::array::from_fn(|k| (0..3).map(|j| rotation[(k, j)].abs()).sum::<f64>() * 0.5 * BLOCK_EDGE as f64 * self.voxel);
        let mut stack = vec![(tree.root_key(), tree.root_level(), *tree.root())];
        while let Some((key, level, octant)) = stack.pop() {
            if octant.payload.max == UNKNOWN {
                continue;
            }
            let blocks = f64::from(1u32 << level);
            let centre = moved(t_frame_submap, block_coords(key).map(|c| (f64::from(c) + 0.5 * blocks) * BLOCK_EDGE as f64 * self.voxel));
            let corner = |side: f64| -> [f32; 3] { std::array::from_fn(|k| (centre[k] + side * blocks * reach[k]) as f32) };
            let (low, high) = (corner(-1.0), corner(1.0));
            if (0..3).all(|k| low[k] >= bounds.min[k] && high[k] <= bounds.max[k]) {
                continue;
            }
            if level > 0 && octant.link != NONE {
                let children = tree.siblings(octant.link).iter().enumerate();
                stack.extend(children.map(|(i, child)| (key | (i as u64) << (3 * (level - 1)), level - 1, *child)));
            } else {
                bounds.add(low);
                bounds.add(high);
            }
        }
        bounds
    }
}
