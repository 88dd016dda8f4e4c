//! Where does a ray end? From cell to cell, each as large as the octree's maxima allow.
//!
//! The way is kept in whole numbers: a step leaves through the plane of a face, so the next cell follows exactly and no
//! voxel that the ray passes can be missed.

use super::field::{blocks, is_clear};
use super::{FieldQuery, UnknownAs};
use crate::field::occupancy::{OccupancyField, State, state_of};
use crate::geometry::morton::AXIS_BITS;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, block_coords, voxel_index};

/// A line of limited length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: [f64; 3],
    /// Where it goes; of any length but zero.
    pub direction: [f64; 3],
    /// How far it goes, metres.
    pub length: f64,
}

/// What stopped a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayHit {
    /// Distance from the origin to the face of the voxel that stopped it, metres.
    pub distance: f64,
    /// Normal of that face, towards the origin; zero when the ray starts in something that stops it.
    pub normal: [f64; 3],
    /// What stopped it: [`State::Occupied`] or [`State::Unknown`].
    pub state: State,
}

impl Ray {
    /// The ray with a direction of length 1; none when a number is not finite, the direction zero or the length negative.
    pub(super) fn normalised(&self) -> Option<Self> {
        let norm = self.direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        let is_finite = self.origin.iter().chain(&self.direction).all(|c| c.is_finite()) && norm.is_finite();
        (is_finite && norm > 0.0 && self.length >= 0.0).then(|| Self { direction: self.direction.map(|c| c / norm), ..*self })
    }
}

impl FieldQuery<'_> {
    /// The first voxel along `ray` (submap frame) that is occupied or, unless it counts as free, unknown; space outside
    /// of the field is unknown. None when the ray ends before, and for a ray that is none.
    pub fn cast(&self, ray: &Ray, unknown: UnknownAs) -> Option<RayHit> {
        self.cast_from(&ray.normalised()?, 0.0, unknown)
    }

    /// As [`cast`](Self::cast) for a normalised ray, from `start` metres along it.
    pub(super) fn cast_from(&self, ray: &Ray, start: f64, unknown: UnknownAs) -> Option<RayHit> {
        let stopped = match unknown {
            UnknownAs::Blocked => Walk::new(self, ray).run::<true>(start * self.per_metre),
            UnknownAs::Free => Walk::new(self, ray).run::<false>(start * self.per_metre),
        }?;
        let normal = std::array::from_fn(|k| if stopped.axis == k { -ray.direction[k].signum() } else { 0.0 });
        Some(RayHit { distance: stopped.at * self.voxel, normal, state: stopped.state })
    }
}

/// Where a walk was stopped: distance in voxels, axis of the face that it came through (3: none).
struct Stopped {
    at: f64,
    axis: usize,
    state: State,
}

/// A ray in finest voxels from the smallest corner of the root cube.
struct Walk<'a> {
    field: &'a OccupancyField,
    origin: [f64; 3],
    direction: [f64; 3],
    inverse: [f64; 3],
    length: f64,
    /// Edge of the root cube.
    edge: u32,
}

/// A cube that the ray passes.
#[derive(Clone, Copy)]
struct Cell {
    low: [u32; 3],
    edge: u32,
}

impl<'a> Walk<'a> {
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

    /// Where the ray is in the root cube: distances of entry and exit and the axis entered through; none when it misses.
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

    /// Walks from `start` voxels along the ray. `STRICT`: unknown space stops it.
    fn run<const STRICT: bool>(&self, start: f64) -> Option<Stopped> {
        let unknown = |at: f64, axis: usize| (STRICT && at <= self.length).then_some(Stopped { at, axis, state: State::Unknown });
        let Some((enter, leave, entered)) = self.clip().filter(|(_, leave, _)| *leave > start) else { return unknown(start, 3) };
        let (mut at, mut axis) = (start, 3);
        if enter > start {
            if STRICT {
                return unknown(start, 3);
            }
            (at, axis) = (enter, entered);
        }
        let mut place: [u32; 3] = std::array::from_fn(|k| ((self.origin[k] + at * self.direction[k]) as u32).min(self.edge - 1));
        let mut path = Path::new(self.field);
        while at <= self.length {
            let cell = match path.clear_cell::<STRICT>(place) {
                Ok(cell) => cell,
                Err(state) => return Some(Stopped { at, axis, state }),
            };
            (at, axis) = self.exit(&cell);
            match self.next(&cell, at, axis) {
                Some(next) => {
                    path.leave(place, next);
                    place = next;
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

    /// The voxel behind the face through which the ray leaves a cell; none outside of the root cube.
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

/// The way from the root to where the ray is.
struct Path<'a> {
    field: &'a OccupancyField,
    /// `groups[l]` holds the octant of level l around the place; valid from the level of `level` up.
    groups: [u32; AXIS_BITS as usize + 1],
    /// Level from which the next descent starts: the octant there is in `groups`, unless it is the root.
    level: u32,
    /// The block that the place is in, if the last cell was in one.
    block: Option<(&'a [i8], u32)>,
}

impl<'a> Path<'a> {
    fn new(field: &'a OccupancyField) -> Self {
        Self { field, groups: [NONE; AXIS_BITS as usize + 1], level: field.tree().root_level(), block: None }
    }

    /// The ray goes from voxel `from` to voxel `to`: how much of the way still holds?
    #[inline(always)]
    fn leave(&mut self, from: [u32; 3], to: [u32; 3]) {
        let differing = (from[0] ^ to[0]) | (from[1] ^ to[1]) | (from[2] ^ to[2]);
        if differing >> BLOCK_SHIFT != 0 {
            self.block = None;
            self.level = 31 - (differing >> BLOCK_SHIFT).leading_zeros();
        }
    }

    /// The largest cell around `place` in which nothing stops the ray, or what stops it there.
    #[inline(always)]
    fn clear_cell<const STRICT: bool>(&mut self, place: [u32; 3]) -> Result<Cell, State> {
        let policy = if STRICT { UnknownAs::Blocked } else { UnknownAs::Free };
        if let Some((values, scale)) = self.block {
            return voxel_cell(values, scale, place, policy);
        }
        let tree = self.field.tree();
        let root = tree.root_level();
        let mut level = self.level;
        loop {
            let octant = if level == root { *tree.root() } else { tree.siblings(self.groups[level as usize])[digit(place, level)] };
            let edge = (BLOCK_EDGE as u32) << level;
            if is_clear(&octant.payload, policy) {
                return Ok(Cell { low: place.map(|c| c & !(edge - 1)), edge });
            }
            if octant.link == NONE {
                return Err(state_of(octant.payload.value));
            }
            if level == 0 {
                let block = self.field.block(octant.link);
                let (values, scale) = (self.field.values(block), u32::from(block.scale));
                self.block = Some((values, scale));
                return voxel_cell(values, scale, place, policy);
            }
            level -= 1;
            self.groups[level as usize] = octant.link;
        }
    }
}

/// Which of its siblings the octant of `level` around `place` is.
#[inline(always)]
fn digit(place: [u32; 3], level: u32) -> usize {
    let shift = level + BLOCK_SHIFT;
    ((place[0] >> shift & 1) | (place[1] >> shift & 1) << 1 | (place[2] >> shift & 1) << 2) as usize
}

/// The voxel around `place` in a block.
#[inline(always)]
fn voxel_cell(values: &[i8], scale: u32, place: [u32; 3], policy: UnknownAs) -> Result<Cell, State> {
    let local = place.map(|c| (c as usize & (BLOCK_EDGE - 1)) >> scale);
    let value = values[voxel_index(local, scale as usize)];
    if blocks(value, policy) {
        return Err(state_of(value));
    }
    let edge = 1 << scale;
    Ok(Cell { low: place.map(|c| c & !(edge - 1)), edge })
}
