//! A robot on wheels: it goes where the floor goes, as far as the map shows one.

use crate::error::PlanError;
use crate::points::{Point, between};
use crate::robot::Robot;
use crate::space::{Air, Fit, Space, is_within};
use hashbrown::HashMap;
use std::cell::RefCell;
use voxelastic::query::{AtlasQuery, Ray, RayHit, UnknownAs};

/// The floor is looked at in steps of this length along the way, metres: about a wheel's footprint.
pub const STRIDE: f64 = 0.25;
/// Largest step of the floor within a stride that wheels take, metres.
const STEP: f64 = 0.2;
/// How far below a place its floor is looked for, metres.
const DEPTH: f64 = 20.0;
/// Far from the sensor a floor is hit here and there only. Between hits no farther away than this, metres, it is taken to go on.
const GAP: f64 = 1.0;
/// The floor is looked at in the middles of columns of this width, from heights this far apart, metres.
const COLUMN: f64 = 0.125;
/// Between hits, in the middles of columns of this width, metres.
const WIDE: f64 = 0.25;
/// So many hits say how high the floor between them is.
const FEW: usize = 5;
/// Where a sensor stood it did not see the floor: free space ends up to this far above it, metres.
const BLIND: f64 = 1.5;

/// A ball that is kept at one height over the floor.
///
/// The floor is the first occupied voxel straight below. Where there is none and free space ends in unknown space, the floor is that of the nearest
/// occupied voxels within a metre to the side, if it is not much higher; otherwise wheels do not go there. If unknown space counts as free, they
/// keep their height where no floor is known. Small differences (a voxel: the floor's own thickness) are not followed.
#[derive(Clone, Debug)]
pub struct Ground<'a> {
    air: Air<'a>,
    map: &'a AtlasQuery<'a>,
    unknown: UnknownAs,
    height: f64,
    step: f64,
    /// Heights of the floor seen so far, by the column and the height looked from.
    floors: Seen,
    /// The same of hits alone, in wider columns.
    hits: Seen,
    /// The wider columns around one, the nearest first.
    around: Vec<[i32; 2]>,
}

type Seen = RefCell<HashMap<[i32; 3], Option<f64>>>;

impl<'a> Ground<'a> {
    /// The space of a wheeled `robot` that starts at `start`.
    ///
    /// # Errors
    /// [`PlanError::Setting`] when the robot's height leaves no room for its radius above the floor.
    pub fn new(map: &'a AtlasQuery<'a>, robot: &Robot, start: Point, bounds: [Point; 2]) -> Result<Self, PlanError> {
        let wheels = robot.ground.unwrap_or_default();
        // A floor is as much as a voxel too thick, and shows a voxel up or down.
        let least = robot.radius + 2.0 * map.voxel();
        if let Some(value) = wheels.height.filter(|h| *h < least) {
            return Err(PlanError::Setting {
                what: "the robot's height above the floor",
                value,
                must: "must be at least its radius and two voxels, or the robot touches the floor",
            });
        }
        let air = Air::new(map, robot, bounds);
        let mut ground = Self {
            air,
            map,
            unknown: robot.unknown,
            height: 0.0,
            step: wheels.step.unwrap_or(STEP),
            floors: Seen::default(),
            hits: Seen::default(),
            around: around(),
        };
        ground.height = wheels.height.unwrap_or_else(|| ground.floor(start, DEPTH).map_or(least, |floor| (start[2] - floor).max(least)));
        Ok(ground)
    }

    /// Height of the robot's centre above the floor, metres.
    pub fn height(&self) -> f64 {
        self.height
    }

    /// Height of the floor below `p`, map frame, if one is known within `depth` metres.
    fn floor(&self, p: Point, depth: f64) -> Option<f64> {
        if let Some(hit) = self.down(p, depth, UnknownAs::Free) {
            return Some(p[2] - hit.distance).filter(|_| hit.distance > 0.0);
        }
        let hit = self.down(p, depth, self.unknown).filter(|hit| hit.distance > 0.0)?;
        self.floor_beside([p[0], p[1], p[2] - hit.distance], depth.min(hit.distance + BLIND) - hit.distance)
    }

    fn down(&self, origin: Point, length: f64, unknown: UnknownAs) -> Option<RayHit> {
        self.map.cast(&Ray { origin, direction: [0.0, 0.0, -1.0], length }, unknown)
    }

    /// Height of the floor around `p`, where free space ends: the middle one of the nearest hits to the side, no more than a step
    /// above or `depth` metres below. A single one may be of the foot of a wall.
    fn floor_beside(&self, p: Point, depth: f64) -> Option<f64> {
        let [x, y, z] = [p[0] / WIDE, p[1] / WIDE, (p[2] + self.step) / COLUMN].map(|c| c.floor() as i32);
        let is_near = |hit: &f64| *hit >= p[2] - depth;
        let beside = self.around.iter().filter_map(|[dx, dy]| self.hit_near([x.saturating_add(*dx), y.saturating_add(*dy), z]).filter(is_near));
        let mut hits: Vec<f64> = beside.take(FEW).collect();
        hits.sort_unstable_by(f64::total_cmp);
        hits.get(hits.len().saturating_sub(1) / 2).copied()
    }

    /// Height of the nearest hit below the height of a wider column.
    fn hit_near(&self, key: [i32; 3]) -> Option<f64> {
        let seen = || {
            let from = [(f64::from(key[0]) + 0.5) * WIDE, (f64::from(key[1]) + 0.5) * WIDE, f64::from(key[2]) * COLUMN];
            let hit = self.down(from, self.step + BLIND, UnknownAs::Free).filter(|hit| hit.distance > 0.0)?;
            Some(from[2] - hit.distance)
        };
        *self.hits.borrow_mut().entry(key).or_insert_with(seen)
    }

    /// Height of the floor under a robot over `[x, y]` at height `z`.
    fn floor_near(&self, x: f64, y: f64, z: f64) -> Option<f64> {
        let column = [x, y, z].map(|c| (c / COLUMN).floor());
        let seen = || self.floor(column.map(|c| (c + 0.5) * COLUMN), self.height + self.step + self.map.voxel() + COLUMN);
        // Far beyond all maps the keys run out, and the floor too.
        *self.floors.borrow_mut().entry(column.map(|c| c as i32)).or_insert_with(seen)
    }

    /// The state over `[x, y]` for a robot that is near at height `z`.
    fn follow(&self, x: f64, y: f64, z: f64) -> Option<Point> {
        let floor = self.floor_near(x, y, z);
        let floor = match (floor, self.unknown) {
            (None, UnknownAs::Free) => return Some([x, y, z]),
            (floor, _) => floor?,
        };
        let rise = floor + self.height - z;
        let is_level = rise.abs() <= 1.01 * self.map.voxel();
        (rise.abs() <= self.step + self.map.voxel()).then_some([x, y, if is_level { z } else { z + rise }])
    }

    /// Whether the middle of the way is free of what no floor rises above: most that is in the way is found like this.
    fn may_pass(&self, from: Point, to: Point) -> bool {
        let level = [to[0], to[1], from[2]];
        self.air.is_free_at(level) && self.air.is_free_at(between(from, level, 0.5))
    }

    /// Follows the floor; gives every state at which the height changes, and the last, to `visit`, which may end the way.
    fn drive(&self, from: Point, to: Point, mut visit: impl FnMut(Point, Point) -> bool) -> Option<Point> {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let strides = (dx.hypot(dy) / STRIDE).ceil().max(1.0) as usize;
        // The last state that was visited, and the last one looked at.
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

/// The wider columns no farther than [`GAP`] from one, the nearest first.
fn around() -> Vec<[i32; 2]> {
    let count = (GAP / WIDE) as i32;
    let all = (-count..=count).flat_map(|x| (-count..=count).map(move |y| [x, y]));
    let squared = |c: &[i32; 2]| c[0] * c[0] + c[1] * c[1];
    let mut near: Vec<[i32; 2]> = all.filter(|c| squared(c) <= count * count).collect();
    near.sort_by_key(|c| (squared(c), *c));
    near
}

impl Space for Ground<'_> {
    fn reach(&self, from: Point, to: Point) -> Option<Point> {
        if !self.may_pass(from, to) {
            return None;
        }
        let arrived = self.drive(from, to, |from, to| self.air.is_free(from, to))?;
        is_within(&self.air.bounds(), arrived).then_some(arrived)
    }

    fn settle(&self, p: Point) -> Option<Point> {
        self.air.settle(self.lay(p)?)
    }

    fn is_blocked(&self, p: Point) -> bool {
        self.air.is_blocked(p)
    }

    fn lay(&self, p: Point) -> Option<Point> {
        let z = match (self.floor(p, DEPTH), self.unknown) {
            (None, UnknownAs::Free) => p[2],
            (floor, _) => floor? + self.height,
        };
        // Where the robot that comes from elsewhere would be.
        self.follow(p[0], p[1], z)
    }

    fn alongside(&self, from: Point, to: Point) -> Option<Point> {
        self.follow(to[0], to[1], from[2])
    }

    fn fit(&self, p: Point, less: f64) -> Fit {
        self.air.fit(p, less)
    }

    fn bounds(&self) -> [Point; 2] {
        self.air.bounds()
    }

    fn is_same(&self, a: Point, b: Point) -> bool {
        (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9 && (a[2] - b[2]).abs() <= 2.02 * self.map.voxel()
    }

    fn dimensions(&self) -> usize {
        2
    }

    fn longest(&self) -> f64 {
        // A slope of 20 degrees does not rise above the robot's middle within this.
        2.5
    }

    fn leads_back(&self, from: Point, arrived: Point) -> bool {
        // Up a step may be a stride before or after down it.
        self.joins(arrived, from)
    }

    /// Where the floor is looked at depends on where a motion began, and a traced piece begins elsewhere: it holds as long as the ball has room
    /// and the floor is no more than a step off.
    fn holds(&self, from: Point, to: Point) -> bool {
        let strides = ((to[0] - from[0]).hypot(to[1] - from[1]) / STRIDE).ceil().max(1.0) as usize;
        let has_floor = (1..=strides).map(|i| between(from, to, i as f64 / strides as f64)).all(|p| self.follow(p[0], p[1], p[2]).is_some());
        has_floor && self.air.is_free(from, to)
    }

    fn trace(&self, from: Point, to: Point, way: &mut Vec<Point>) {
        let mut states = Vec::new();
        let arrived = self.drive(from, to, |_, to| {
            states.push(to);
            true
        });
        way.append(&mut states);
        if arrived.is_none() {
            way.push(to);
        }
    }
}
