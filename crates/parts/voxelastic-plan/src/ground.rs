//! The configuration space of a wheeled robot, which follows the floor of the map.

use crate::error::PlanError;
use crate::flying::FlyingSpace;
use crate::points::{Point, between};
use crate::robot::Robot;
use crate::space::{Fit, Space, is_within};
use hashbrown::HashMap;
use std::cell::RefCell;
use voxelastic::query::{AtlasQuery, Ray, RayHit, UnknownAs};

/// The floor is sampled along a motion at this interval, metres: about a wheel's footprint.
pub const STRIDE: f64 = 0.25;
/// Default of the largest step of the floor within [`STRIDE`], metres.
const DEFAULT_STEP: f64 = 0.2;
/// How far below a position its floor is searched for, metres.
const MAX_DEPTH: f64 = 20.0;
/// Radius within which the floor is interpolated between its observed voxels, metres: far from the sensor it is observed sparsely.
const GAP_RADIUS: f64 = 1.0;
/// The floor is sampled at the centres of columns of this width, from heights that are multiples of it, metres.
const COLUMN: f64 = 0.125;
/// Width of the columns used to interpolate the floor, metres.
const WIDE_COLUMN: f64 = 0.25;
/// Number of observed floor heights whose median is the interpolated height.
const MEDIAN_OF: usize = 5;
/// Below a sensor the floor is not observed: free space may end this far above it, metres.
const BLIND_HEIGHT: f64 = 1.5;

/// A ball whose centre is kept at one height above the floor.
///
/// The floor is the first occupied voxel straight below. Where free space ends in unknown space instead, the floor height is interpolated from the
/// nearest occupied voxels within a metre to the side, if they are not much higher; otherwise the robot cannot go there. If unknown space counts as
/// free, the robot keeps its height where no floor is known. Differences of up to a voxel, the thickness of the floor in the map, are ignored.
#[derive(Clone, Debug)]
pub struct GroundSpace<'a> {
    flying: FlyingSpace<'a>,
    map: &'a AtlasQuery<'a>,
    unknown: UnknownAs,
    height: f64,
    step: f64,
    /// Cached floor heights, by column and height of the query.
    floors: HeightCache,
    /// Cached heights of observed floor voxels only, in wide columns.
    observed: HeightCache,
    /// Offsets of the wide columns within [`GAP_RADIUS`], the nearest first.
    around: Vec<[i32; 2]>,
}

/// Floor height below a column (x, y) as found from a height (z); none where there is no floor.
type HeightCache = RefCell<HashMap<[i32; 3], Option<f64>>>;

impl<'a> GroundSpace<'a> {
    /// The space of a wheeled `robot` that starts at `start`.
    ///
    /// # Errors
    /// [`PlanError::Setting`] when the robot's height leaves no room for its radius above the floor.
    pub fn new(map: &'a AtlasQuery<'a>, robot: &Robot, start: Point, bounds: [Point; 2]) -> Result<Self, PlanError> {
        let wheels = robot.ground.unwrap_or_default();
        // In the map the floor is up to a voxel thicker, and up to a voxel higher or lower.
        let least = robot.radius + 2.0 * map.voxel_size();
        if let Some(value) = wheels.height.filter(|h| *h < least) {
            return Err(PlanError::Setting {
                what: "the robot's height above the floor",
                value,
                must: "must be at least its radius and two voxels, or the robot touches the floor",
            });
        }
        let flying = FlyingSpace::new(map, robot, bounds);
        let mut ground = Self {
            flying,
            map,
            unknown: robot.unknown,
            height: 0.0,
            step: wheels.step.unwrap_or(DEFAULT_STEP),
            floors: HeightCache::default(),
            observed: HeightCache::default(),
            around: offsets_within_gap(),
        };
        ground.height = wheels.height.unwrap_or_else(|| ground.floor(start, MAX_DEPTH).map_or(least, |floor| (start[2] - floor).max(least)));
        Ok(ground)
    }

    /// Height of the robot's centre above the floor, metres.
    pub fn height(&self) -> f64 {
        self.height
    }

    /// Height of the floor below `p`, map frame, if it is known within `depth` metres.
    fn floor(&self, p: Point, depth: f64) -> Option<f64> {
        if let Some(hit) = self.cast_down(p, depth, UnknownAs::Free) {
            return Some(p[2] - hit.distance).filter(|_| hit.distance > 0.0);
        }
        let hit = self.cast_down(p, depth, self.unknown).filter(|hit| hit.distance > 0.0)?;
        self.interpolated_floor([p[0], p[1], p[2] - hit.distance], depth.min(hit.distance + BLIND_HEIGHT) - hit.distance)
    }

    fn cast_down(&self, origin: Point, length: f64, unknown: UnknownAs) -> Option<RayHit> {
        self.map.ray_cast(&Ray { origin, direction: [0.0, 0.0, -1.0], length }, unknown)
    }

    /// Height of the floor around `p`, where free space ends: the median of the nearest observed heights to the side, no more than a step above or
    /// `depth` metres below. A single one may belong to the foot of a wall.
    fn interpolated_floor(&self, p: Point, depth: f64) -> Option<f64> {
        let [x, y, z] = [p[0] / WIDE_COLUMN, p[1] / WIDE_COLUMN, (p[2] + self.step) / COLUMN].map(|c| c.floor() as i32);
        let is_near = |height: &f64| *height >= p[2] - depth;
        let nearby = self.around.iter().filter_map(|[dx, dy]| self.observed_floor([x.saturating_add(*dx), y.saturating_add(*dy), z]).filter(is_near));
        let mut heights: Vec<f64> = nearby.take(MEDIAN_OF).collect();
        heights.sort_unstable_by(f64::total_cmp);
        heights.get(heights.len().saturating_sub(1) / 2).copied()
    }

    /// Height of the first occupied voxel below a key of a wide column.
    fn observed_floor(&self, key: [i32; 3]) -> Option<f64> {
        let observe = || {
            let from = [(f64::from(key[0]) + 0.5) * WIDE_COLUMN, (f64::from(key[1]) + 0.5) * WIDE_COLUMN, f64::from(key[2]) * COLUMN];
            let hit = self.cast_down(from, self.step + BLIND_HEIGHT, UnknownAs::Free).filter(|hit| hit.distance > 0.0)?;
            Some(from[2] - hit.distance)
        };
        *self.observed.borrow_mut().entry(key).or_insert_with(observe)
    }

    /// Height of the floor below a robot at `[x, y]` and height `z`.
    fn floor_below_robot(&self, x: f64, y: f64, z: f64) -> Option<f64> {
        let column = [x, y, z].map(|c| (c / COLUMN).floor());
        let find = || self.floor(column.map(|c| (c + 0.5) * COLUMN), self.height + self.step + self.map.voxel_size() + COLUMN);
        // The conversion saturates far outside of any map, where there is no floor either.
        *self.floors.borrow_mut().entry(column.map(|c| c as i32)).or_insert_with(find)
    }

    /// The state at `[x, y]` of a robot that comes from nearby at height `z`.
    fn follow(&self, x: f64, y: f64, z: f64) -> Option<Point> {
        let floor = self.floor_below_robot(x, y, z);
        let floor = match (floor, self.unknown) {
            (None, UnknownAs::Free) => return Some([x, y, z]),
            (floor, _) => floor?,
        };
        let rise = floor + self.height - z;
        let is_level = rise.abs() <= 1.01 * self.map.voxel_size();
        (rise.abs() <= self.step + self.map.voxel_size()).then_some([x, y, if is_level { z } else { z + rise }])
    }

    /// Whether two points at the start's height are free: a cheap test that finds most obstacles.
    fn may_be_free(&self, from: Point, to: Point) -> bool {
        let level = [to[0], to[1], from[2]];
        self.flying.is_free_at(level) && self.flying.is_free_at(between(from, level, 0.5))
    }

    /// Follows the floor from a state towards `to`. Calls `visit` with each straight part of the motion, which may stop it by returning false.
    fn follow_floor(&self, from: Point, to: Point, mut visit: impl FnMut(Point, Point) -> bool) -> Option<Point> {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let strides = (dx.hypot(dy) / STRIDE).ceil().max(1.0) as usize;
        // End of the last part that was visited, and the last state.
        let (mut corner, mut last) = (from, from);
        for i in 1..=strides {
            let share = i as f64 / strides as f64;
            let next = self.follow(from[0] + share * dx, from[1] + share * dy, last[2])?;
            if next[2] != last[2] {
                if last != corner && !visit(corner, last) {
                    return None;
                }
                if !visit(last, next) {
                    return None;
                }
                corner = next;
            }
            last = next;
        }
        (last == corner || visit(corner, last)).then_some(last)
    }
}

/// Offsets of the wide columns no farther than [`GAP_RADIUS`] from one, the nearest first.
fn offsets_within_gap() -> Vec<[i32; 2]> {
    let count = (GAP_RADIUS / WIDE_COLUMN) as i32;
    let all = (-count..=count).flat_map(|x| (-count..=count).map(move |y| [x, y]));
    let squared = |c: &[i32; 2]| c[0] * c[0] + c[1] * c[1];
    let mut near: Vec<[i32; 2]> = all.filter(|c| squared(c) <= count * count).collect();
    near.sort_by_key(|c| (squared(c), *c));
    near
}

impl Space for GroundSpace<'_> {
    fn steer(&self, from: Point, to: Point) -> Option<Point> {
        if !self.may_be_free(from, to) {
            return None;
        }
        let arrived = self.follow_floor(from, to, |from, to| self.flying.is_free(from, to))?;
        is_within(&self.flying.bounds(), arrived).then_some(arrived)
    }

    fn state_at(&self, p: Point) -> Option<Point> {
        self.flying.state_at(self.project(p)?)
    }

    fn is_blocked(&self, p: Point) -> bool {
        self.flying.is_blocked(p)
    }

    fn project(&self, p: Point) -> Option<Point> {
        let z = match (self.floor(p, MAX_DEPTH), self.unknown) {
            (None, UnknownAs::Free) => p[2],
            (floor, _) => floor? + self.height,
        };
        // The same rounding as for a robot that arrives there.
        self.follow(p[0], p[1], z)
    }

    fn neighbour_state(&self, from: Point, to: Point) -> Option<Point> {
        self.follow(to[0], to[1], from[2])
    }

    fn fit(&self, p: Point, margin: f64) -> Fit {
        self.flying.fit(p, margin)
    }

    fn bounds(&self) -> [Point; 2] {
        self.flying.bounds()
    }

    fn is_same(&self, a: Point, b: Point) -> bool {
        (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9 && (a[2] - b[2]).abs() <= 2.02 * self.map.voxel_size()
    }

    fn dimensions(&self) -> usize {
        2
    }

    fn max_step(&self) -> f64 {
        // Within this a slope of 20 degrees does not rise above the robot's centre.
        2.5
    }

    fn is_reversible(&self, from: Point, arrived: Point) -> bool {
        // Up and down, a step of the floor may fall into different strides.
        self.connects(arrived, from)
    }

    /// The points at which the floor is sampled depend on where a motion starts, and a traced segment starts elsewhere. So it is free as long as the
    /// sweep of the ball is free and the floor differs by no more than a step.
    fn is_segment_free(&self, from: Point, to: Point) -> bool {
        let strides = ((to[0] - from[0]).hypot(to[1] - from[1]) / STRIDE).ceil().max(1.0) as usize;
        let has_floor = (1..=strides).map(|i| between(from, to, i as f64 / strides as f64)).all(|p| self.follow(p[0], p[1], p[2]).is_some());
        has_floor && self.flying.is_free(from, to)
    }

    fn trace(&self, from: Point, to: Point, path: &mut Vec<Point>) {
        let mut states = Vec::new();
        let arrived = self.follow_floor(from, to, |_, to| {
            states.push(to);
            true
        });
        path.append(&mut states);
        if arrived.is_none() {
            path.push(to);
        }
    }
}
