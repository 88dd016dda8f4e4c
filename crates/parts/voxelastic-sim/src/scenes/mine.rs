//! The mine: seven rooms hewn from rock, about 100 m across, joined by corridors with narrow doorways, with pillars and
//! rubble. The rough rock consists of thousands of spheres and blocks half embedded in walls and ceilings, whose distance
//! is exact, unlike that of a noise field.

use super::albedo;
use super::floor_plan::{Area, FloorPlan, Wall};
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// Rooms are about the nodes of a grid with this spacing, metres; corridors run along its lines.
const GRID: f64 = 38.0;
/// Nodes with a room.
const ROOMS: [[usize; 2]; 7] = [[0, 0], [1, 0], [1, 1], [1, 2], [2, 2], [2, 1], [0, 1]];
/// Neighbouring rooms joined by a corridor.
const CORRIDORS: [[usize; 2]; 8] = [[0, 1], [1, 2], [2, 3], [3, 4], [5, 4], [2, 5], [6, 2], [0, 6]];
/// A figure of eight that meets itself in the middle room: 8 corridors of [`GRID`] metres.
const CORNERS: [[usize; 2]; 6] = [[0, 0], [1, 0], [1, 2], [2, 2], [2, 1], [0, 1]];
/// Top of the rock, metres: above every ceiling.
const TOP: f64 = 7.0;
/// Width of a doorway, metres.
const DOORWAY: f64 = 1.2;

fn node(at: [usize; 2]) -> [f64; 2] {
    [at[0] as f64 * GRID, at[1] as f64 * GRID]
}

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    let rooms: Vec<Area> = ROOMS.map(|at| room(b, node(at))).to_vec();
    let corridors: Vec<Area> = CORRIDORS.iter().map(|&[from, to]| corridor(b, (from, to), &rooms)).collect();
    let areas: Vec<Area> = rooms.iter().chain(&corridors).copied().collect();
    b.ground(0.0, albedo::ROCK);
    let floor_plan = FloorPlan::new(&areas, 8.0);
    for (low, high) in floor_plan.rock() {
        b.cuboid([low[0], low[1], -0.5], [high[0], high[1], TOP], albedo::ROCK);
    }
    for area in &areas {
        b.cuboid([area.low[0] - 0.5, area.low[1] - 0.5, area.ceiling], [area.high[0] + 0.5, area.high[1] + 0.5, TOP], albedo::ROCK);
    }
    floor_plan.walls().iter().for_each(|wall| rough_wall(b, wall));
    corridors.iter().for_each(|c| doorway(b, c));
    for (area, at) in rooms.iter().zip(ROOMS) {
        rough_ceiling(b, area);
        pillars(b, area, node(at));
    }
    (Route::rounded(&CORNERS.map(node), 3.0), Carrier::ROBOT)
}

fn room(b: &mut WorldBuilder, [x, y]: [f64; 2]) -> Area {
    let mut reach = || b.random.range(6.5, 10.5);
    let (low, high) = ([x - reach(), y - reach()], [x + reach(), y + reach()]);
    Area { low, high, ceiling: b.random.range(3.2, 5.0), roughness: 0.35 }
}

/// The corridor between two neighbouring rooms; the first is to the west or south of the second.
fn corridor(b: &mut WorldBuilder, (from, to): (usize, usize), rooms: &[Area]) -> Area {
    let half = b.random.range(0.95, 1.5);
    let ceiling = b.random.range(2.3, 2.8);
    let (a, c) = (&rooms[from], &rooms[to]);
    let middle = node(ROOMS[from]);
    let along_x = ROOMS[from][1] == ROOMS[to][1];
    let (low, high) = if along_x {
        ([a.high[0], middle[1] - half], [c.low[0], middle[1] + half])
    } else {
        ([middle[0] - half, a.high[1]], [middle[0] + half, c.low[1]])
    };
    Area { low, high, ceiling, roughness: 0.2 }
}

/// Jambs and a lintel in the middle of a corridor.
fn doorway(b: &mut WorldBuilder, area: &Area) {
    let along = usize::from(area.high[1] - area.low[1] > area.high[0] - area.low[0]);
    let across = 1 - along;
    let middle = (area.low[along] + area.high[along]) / 2.0;
    let centre = (area.low[across] + area.high[across]) / 2.0;
    let mut part = |low: f64, high: f64, bottom: f64, top: f64| {
        let (mut from, mut to) = ([0.0, 0.0, bottom], [0.0, 0.0, top]);
        (from[along], to[along]) = (middle - 0.25, middle + 0.25);
        (from[across], to[across]) = (low, high);
        b.cuboid(from, to, albedo::WOOD);
    };
    part(area.low[across] - 0.3, centre - DOORWAY / 2.0, -0.2, TOP - 2.0);
    part(centre + DOORWAY / 2.0, area.high[across] + 0.3, -0.2, TOP - 2.0);
    part(area.low[across] - 0.3, area.high[across] + 0.3, 2.0, TOP - 2.0);
}

/// Spheres and rotated blocks embedded in the wall that protrude by no more than its roughness. The ends of the wall are left out, where they would
/// block corridors.
fn rough_wall(b: &mut WorldBuilder, wall: &Wall) {
    let (dx, dy) = (wall.to[0] - wall.from[0], wall.to[1] - wall.from[1]);
    let length = dx.hypot(dy);
    let count = (length * wall.ceiling * 1.1) as usize;
    for _ in 0..count {
        let radius = b.random.range(0.25, 0.9).min(0.45 * length);
        let out = b.random.range(0.3, 1.0) * wall.roughness.min(0.6 * radius);
        let along = b.random.range(radius, length - radius) / length;
        let z = b.random.range(-0.1, wall.ceiling);
        let block = b.random.index(3) == 0;
        let size: [f64; 3] = std::array::from_fn(|_| radius * b.random.range(0.6, 1.4));
        let depth = if block { 0.5 * size[0].hypot(size[1]) } else { radius } - out;
        let at = [wall.from[0] + dx * along - wall.inwards[0] * depth, wall.from[1] + dy * along - wall.inwards[1] * depth, z];
        let albedo = albedo::ROCK * b.random.range(0.6, 1.6) as f32;
        if block {
            // An edge points into the room.
            let towards = wall.inwards[1].atan2(wall.inwards[0]);
            let yaw = towards - size[1].atan2(size[0]) + b.random.range(-0.1, 0.1);
            b.turned(at, size, yaw, albedo);
        } else {
            b.sphere(at, radius, albedo);
        }
    }
}

/// Bulges of the ceiling and rubble on the floor.
fn rough_ceiling(b: &mut WorldBuilder, area: &Area) {
    let floor = (area.high[0] - area.low[0]) * (area.high[1] - area.low[1]);
    for k in 0..(floor * 0.9) as usize {
        let on_floor = k % 3 == 0;
        let radius = b.random.range(0.3, if on_floor { 0.7 } else { 1.2 });
        let x = b.random.range(area.low[0] + radius, area.high[0] - radius);
        let y = b.random.range(area.low[1] + radius, area.high[1] - radius);
        let z = if on_floor { b.random.range(0.02, 0.15) - radius } else { area.ceiling + radius - b.random.range(0.1, 0.45) };
        b.sphere([x, y, z], radius, albedo::ROCK * 1.2);
    }
}

/// One or two pillars of rock in each quarter of a room that has space for them, away from the routes through the room.
fn pillars(b: &mut WorldBuilder, area: &Area, middle: [f64; 2]) {
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        if b.random.index(4) == 0 {
            continue;
        }
        let at = [middle[0] + sx * b.random.range(3.4, 4.6), middle[1] + sy * b.random.range(3.4, 4.6)];
        let (width, yaw) = (b.random.range(0.9, 1.5), b.random.range(0.0, 1.5));
        b.turned([at[0], at[1], TOP / 2.0 - 0.5], [width, width * 0.8, TOP + 0.5], yaw, albedo::ROCK);
        b.column([at[0], at[1], -0.2], area.ceiling + 0.4, 0.5 * width, albedo::ROCK * 0.9);
        for _ in 0..14 {
            let angle = b.random.range(0.0, std::f64::consts::TAU);
            let radius = b.random.range(0.2, 0.5);
            let reach = 0.5 * width - 0.5 * radius;
            let z = b.random.range(0.0, area.ceiling);
            b.sphere([at[0] + reach * angle.cos(), at[1] + reach * angle.sin(), z], radius, albedo::ROCK * 1.3);
        }
    }
}
