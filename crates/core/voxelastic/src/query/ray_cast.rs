//! Ray casting through the octree, from cell to cell, each as large as the octants' maxima allow.
//!
//! Cells are integer coordinates: each step leaves through the plane of a face, which determines the next cell exactly, so that no voxel on
//! the ray is skipped.

use super::field::{blocks, is_clear};
use super::{FieldQuery, UnknownAs};
use crate::field::occupancy::{OccupancyField, State, state_of};
use crate::geometry::morton::AXIS_BITS;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, block_coords, voxel_index};

/// A line of limited length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start point, metres.
    pub origin: [f64; 3],
    /// Direction, of any length but zero.
    pub direction: [f64; 3],
    /// Length, metres; may be infinite.
    pub length: f64,
}

/// Where and why a ray ended.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RayHit {
    /// Distance from the origin to the face of the blocking voxel, metres.
    pub distance: f64,
    /// Normal of that face, towards the origin; zero if the ray starts in a blocking voxel.
    pub normal: [f64; 3],
    /// State of the blocking voxel: [`State::Occupied`] or [`State::Unknown`].
    pub state: State,
}

impl Ray {
    /// The ray with a direction of length 1; none if a coordinate is not finite, the direction zero or the length negative.
    pub(crate) fn normalised(&self) -> Option<Self> {
        let norm = self.direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        let is_finite = self.origin.iter().chain(&self.direction).all(|c| c.is_finite()) && norm.is_finite();
        (is_finite && norm > 0.0 && self.length >= 0.0).then(|| Self { direction: self.direction.map(|c| c / norm), ..*self })
    }
}

impl FieldQuery<'_> {
    /// First voxel along `ray` (submap frame) that is occupied or, unless it counts as free, unknown; space outside of the field is
    /// unknown. None if the ray ends before, or if the ray is invalid.
    pub fn ray_cast(&self, ray: &Ray, unknown: UnknownAs) -> Option<RayHit> {
        self.ray_cast_from(&ray.normalised()?, 0.0, unknown)
    }

    /// As [`ray_cast`](Self::ray_cast) for a normalised ray, from `start` metres along it.
    pub(crate) fn ray_cast_from(&self, ray: &Ray, start: f64, unknown: UnknownAs) -> Option<RayHit> {
        let end = match unknown {
            UnknownAs::Blocked => Traversal::new(self, ray).run::<true>(start * self.per_metre),
            UnknownAs::Free => Traversal::new(self, ray).run::<false>(start * self.per_metre),
        }?;
        let normal = std::array::from_fn(|k| if end.axis == k { -ray.direction[k].signum() } else { 0.0 });
        Some(RayHit { distance: end.at * self.voxel, normal, state: end.state })
    }
}

/// Where a traversal ended: distance in voxels, axis of the face entered last (3: none).
struct End {
    at: f64,
    axis: usize,
    state: State,
}

/// A ray in finest voxels from the smallest corner of the root cube.
struct Traversal<'a> {
    field: &'a OccupancyField,
    origin: [f64; 3],
    direction: [f64; 3],
    inverse: [f64; 3],
    length: f64,
    /// Edge of the root cube.
    edge: u32,
}

/// A cube on the ray.
#[derive(Clone, Copy)]
struct Cell {
    low: [u32; 3],
    edge: u32,
}

impl<'a> Traversal<'a> {
    fn new(query: &FieldQuery<'a>, ray: &Ray) -> Self {
        let tree = query.field.tree();
        let corner = block_coords(tree.root_key()).map(|c| f64::from(c << BLOCK_SHIFT));
        let edge = if tree.is_empty() { 0 } else { (BLOCK_EDGE as u32) << tree.root_level() };
        Self {
            field: query.field,
            origin: std::array::from_fn(|k| ray.origin[k] * query.per_metre - corner[k]),
            direction: ray.direction,
            inverse: ray.direction.map(|c| 1.0 / c),
            length: ray.length * query.per_metre,
            edge,
        }
    }

    /// Intersection with the root cube: distances of entry and exit, and the axis of the face entered; none if the ray misses it.
    fn clip(&self) -> Option<(f64, f64, usize)> {
        let (mut enter, mut leave, mut axis) = (f64::NEG_INFINITY, f64::INFINITY, 3);
        let edge = f64::from(self.edge);
        for k in 0..3 {
            if self.direction[k] == 0.0 {
                if self.origin[k] < 0.0 || self.origin[k] >= edge {
                    return None;
                }
                continue;
            }
            let (a, b) = (-self.origin[k] * self.inverse[k], (edge - self.origin[k]) * self.inverse[k]);
            if a.min(b) > enter {
                (enter, axis) = (a.min(b), k);
            }
            leave = leave.min(a.max(b));
        }
        (enter < leave).then_some((enter, leave, axis))
    }

    /// Traverses the ray from `start` voxels on. `STRICT`: unknown space ends it.
    fn run<const STRICT: bool>(&self, start: f64) -> Option<End> {
        let unknown = |at: f64, axis: usize| (STRICT && at <= self.length).then_some(End { at, axis, state: State::Unknown });
        let Some((enter, leave, entered)) = self.clip().filter(|(_, leave, _)| *leave > start) else { return unknown(start, 3) };
        let (mut at, mut axis) = (start, 3);
        if enter > start {
            if STRICT {
                return unknown(start, 3);
            }
            (at, axis) = (enter, entered);
        }
        let mut voxel: [u32; 3] = std::array::from_fn(|k| ((self.origin[k] + at * self.direction[k]) as u32).min(self.edge - 1));
        let mut path = Path::new(self.field);
        while at <= self.length {
            let cell = match path.clear_cell::<STRICT>(voxel) {
                Ok(cell) => cell,
                Err(state) => return Some(End { at, axis, state }),
            };
            (at, axis) = self.exit(&cell);
            match self.next(&cell, at, axis) {
                Some(next) => {
                    path.move_to(voxel, next);
                    voxel = next;
                }
                None => return unknown(at.min(leave), axis),
            }
        }
        None
    }

    /// Where the ray leaves a cell: distance and axis.
    #[inline(always)]
    fn exit(&self, cell: &Cell) -> (f64, usize) {
        let t: [f64; 3] = std::array::from_fn(|k| {
            let plane = cell.low[k] + if self.direction[k] > 0.0 { cell.edge } else { 0 };
            let t = (f64::from(plane) - self.origin[k]) * self.inverse[k];
            if self.direction[k] == 0.0 { f64::INFINITY } else { t }
        });
        if t[0] <= t[1] && t[0] <= t[2] {
            (t[0], 0)
        } else if t[1] <= t[2] {
            (t[1], 1)
        } else {
            (t[2], 2)
        }
    }

    /// The voxel beyond the face through which the ray leaves a cell; none outside of the root cube.
    #[inline(always)]
    fn next(&self, cell: &Cell, at: f64, axis: usize) -> Option<[u32; 3]> {
        let mut next = cell.low;
        if cell.edge > 1 {
            next = std::array::from_fn(|k| ((self.origin[k] + at * self.direction[k]) as u32).clamp(cell.low[k], cell.low[k] + cell.edge - 1));
        }
        next[axis] = if self.direction[axis] > 0.0 { cell.low[axis] + cell.edge } else { cell.low[axis].wrapping_sub(1) };
        (next[axis] < self.edge).then_some(next)
    }
}

/// The octants from the root to the current voxel.
struct Path<'a> {
    field: &'a OccupancyField,
    /// `groups[l]` contains the octant of level l around the voxel; valid from `level` up.
    groups: [u32; AXIS_BITS as usize + 1],
    /// Level from which the next descent starts: the octant there is in `groups`, unless it is the root.
    level: u32,
    /// Values and scale of the current block, if the last cell was in one.
    block: Option<(&'a [i8], u32)>,
}

impl<'a> Path<'a> {
    fn new(field: &'a OccupancyField) -> Self {
        Self { field, groups: [NONE; AXIS_BITS as usize + 1], level: field.tree().root_level(), block: None }
    }

    /// Invalidates the part of the path that the step from voxel `from` to voxel `to` leaves.
    #[inline(always)]
    fn move_to(&mut self, from: [u32; 3], to: [u32; 3]) {
        let differing = (from[0] ^ to[0]) | (from[1] ^ to[1]) | (from[2] ^ to[2]);
        if differing >> BLOCK_SHIFT != 0 {
            self.block = None;
            self.level = 31 - (differing >> BLOCK_SHIFT).leading_zeros();
        }
    }

    /// The largest cell around `voxel` that does not block, or the state that blocks.
    #[inline(always)]
    fn clear_cell<const STRICT: bool>(&mut self, voxel: [u32; 3]) -> Result<Cell, State> {
        let policy = if STRICT { UnknownAs::Blocked } else { UnknownAs::Free };
        if let Some((values, scale)) = self.block {
            return voxel_cell(values, scale, voxel, policy);
        }
        let tree = self.field.tree();
        let root = tree.root_level();
        let mut level = self.level;
        loop {
            let octant = if level == root { *tree.root() } else { tree.siblings(self.groups[level as usize])[digit(voxel, level)] };
            let edge = (BLOCK_EDGE as u32) << level;
            if is_clear(&octant.payload, policy) {
                return Ok(Cell { low: voxel.map(|c| c & !(edge - 1)), edge });
            }
            if octant.link == NONE {
                return Err(state_of(octant.payload.value));
            }
            if level == 0 {
                let block = self.field.block(octant.link);
                let (values, scale) = (self.field.values(block), u32::from(block.scale));
                self.block = Some((values, scale));
                return voxel_cell(values, scale, voxel, policy);
            }
            level -= 1;
            self.groups[level as usize] = octant.link;
        }
    }
}

/// Index among its siblings of the octant of `level` around `voxel`.
#[inline(always)]
fn digit(voxel: [u32; 3], level: u32) -> usize {
    let shift = level + BLOCK_SHIFT;
    ((voxel[0] >> shift & 1) | (voxel[1] >> shift & 1) << 1 | (voxel[2] >> shift & 1) << 2) as usize
}

/// The block's voxel that contains finest voxel `voxel`.
#[inline(always)]
fn voxel_cell(values: &[i8], scale: u32, voxel: [u32; 3], policy: UnknownAs) -> Result<Cell, State> {
    let local = voxel.map(|c| (c as usize & (BLOCK_EDGE - 1)) >> scale);
    let value = values[voxel_index(local, scale as usize)];
    if blocks(value, policy) {
        return Err(state_of(value));
    }
    let edge = 1 << scale;
    Ok(Cell { low: voxel.map(|c| c & !(edge - 1)), edge })
}
