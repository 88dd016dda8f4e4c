//! The district: a square kilometre of streets, houses, yards and parks, to explore for an hour and more.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Carrier, Route};
use std::f64::consts::PI;

/// Blocks along x and y.
const BLOCKS: usize = 20;
/// Distance between neighbouring streets, metres: street k is at k times this.
const PITCH: f64 = 50.0;
/// Half the distance between the houses across a street, metres.
const HALF: f64 = 10.0;
/// Thickness of the walls around yards and across streets, metres.
const WALL: f64 = 0.6;
/// The route goes around the blocks between these streets, in the middle; no street there is shut.
const ROUTE: [usize; 2] = [9, 11];

/// A part of a street between two crossings.
#[derive(Clone, Copy)]
struct Street {
    /// The crossing at its lower end.
    crossing: [usize; 2],
    /// Along x (0) or y (1).
    axis: usize,
}

impl Street {
    /// The point `along` the street from the middle of its first crossing, and `aside` from its middle line.
    fn at(self, along: f64, aside: f64) -> [f64; 2] {
        let mut p = self.crossing.map(|c| c as f64 * PITCH);
        p[self.axis] += along;
        p[1 - self.axis] += aside;
        p
    }

    /// Adds a wall that stands on the ground between two points as in [`at`](Self::at).
    fn wall(self, b: &mut WorldBuilder, from: [f64; 2], to: [f64; 2], height: f64) {
        let (from, to) = (self.at(from[0], from[1]), self.at(to[0], to[1]));
        b.cuboid([from[0], from[1], -0.5], [to[0], to[1], height], albedo::STONE);
    }

    fn may_be_shut(self) -> bool {
        self.crossing.iter().any(|c| !(ROUTE[0] - 1..=ROUTE[1] + 1).contains(c))
    }
}

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    b.ground(0.0, albedo::PAVING);
    let (low, high) = (-HALF, BLOCKS as f64 * PITCH + HALF);
    for axis in 0..2 {
        for face in [low - WALL, high] {
            let (mut from, mut to) = ([low - WALL, low - WALL, -0.5], [high + WALL, high + WALL, 6.0]);
            (from[axis], to[axis]) = (face, face + WALL);
            b.cuboid(from, to, albedo::STONE);
        }
    }
    for y in 0..BLOCKS {
        for x in 0..BLOCKS {
            block(b, [x, y].map(|c| c as f64 * PITCH + HALF));
        }
    }
    for y in 0..=BLOCKS {
        for x in 0..=BLOCKS {
            for axis in 0..2 {
                if [x, y][axis] < BLOCKS {
                    street(b, Street { crossing: [x, y], axis });
                }
            }
        }
    }
    let [low, high] = ROUTE.map(|c| c as f64 * PITCH);
    (Route::rounded(&[[low, low], [high, low], [high, high], [low, high]], 6.0), Carrier::ROBOT)
}

/// What is between four streets, from its lower corner on: houses, a yard, or a park.
fn block(b: &mut WorldBuilder, low: [f64; 2]) {
    let size = PITCH - 2.0 * HALF;
    match b.random.index(5) {
        0 | 1 => {
            // Two houses with an alley between them, or a single one.
            let (axis, split, alley) = (b.random.index(2), b.random.range(0.3, 0.7) * size, b.random.index(2) as f64 * 4.0);
            for [from, to] in [[0.0, split - 0.5 * alley], [split + 0.5 * alley, size]] {
                let (mut near, mut far) = ([low[0], low[1], -0.5], [low[0] + size, low[1] + size, b.random.range(6.0, 14.0)]);
                (near[axis], far[axis]) = (low[axis] + from, low[axis] + to);
                b.cuboid(near, far, albedo::TRIM);
            }
        }
        2 | 3 => yard(b, low, size),
        _ => {
            for _ in 0..6 {
                let at = low.map(|c| c + b.random.range(3.0, size - 3.0));
                let scale = b.random.range(0.7, 1.0);
                b.tree(at, scale);
            }
        }
    }
}

/// Walls with one gate or two, and a shed between them.
fn yard(b: &mut WorldBuilder, low: [f64; 2], size: f64) {
    let height = b.random.range(3.0, 5.0);
    let gates = [b.random.index(4), b.random.index(4)];
    for side in 0..4 {
        let (along, face) = (side % 2, if side < 2 { 0.0 } else { size - WALL });
        let gate = b.random.range(6.0, size - 6.0);
        let half = if gates.contains(&side) { b.random.range(1.2, 2.5) } else { 0.0 };
        for [from, to] in [[0.0, gate - half], [gate + half, size]] {
            let (mut near, mut far) = ([low[0], low[1], -0.5], [low[0], low[1], height]);
            (near[along], far[along]) = (low[along] + from, low[along] + to);
            (near[1 - along], far[1 - along]) = (low[1 - along] + face, low[1 - along] + face + WALL);
            b.cuboid(near, far, albedo::STONE);
        }
    }
    let corner = low.map(|c| c + b.random.range(5.0, size - 15.0));
    let opposite = corner.map(|c| c + b.random.range(4.0, 10.0));
    b.cuboid([corner[0], corner[1], -0.5], [opposite[0], opposite[1], 3.5], albedo::WOOD);
}

/// What stands along a street, and, in one of six, a wall across it, every second one with a gate.
fn street(b: &mut WorldBuilder, street: Street) {
    let length = PITCH - 2.0 * HALF;
    for aside in [-1.0, 1.0] {
        let parked = street.at(HALF + b.random.range(3.0, 0.5 * length - 3.0), 7.5 * aside);
        let stands = street.at(HALF + b.random.range(0.5 * length + 2.0, length - 2.0), 8.0 * aside);
        match b.random.index(4) {
            0 | 1 => b.car(parked, if street.axis == 0 { 0.0 } else { 0.5 * PI }),
            2 => b.column([parked[0], parked[1], 0.0], 2.4, 0.7, albedo::PAINT),
            _ => {}
        }
        match b.random.index(3) {
            0 => b.lamp(stands, if street.axis == 0 { -0.5 * PI * aside } else { 0.5 * PI * (1.0 + aside) }),
            1 => b.bollard(stands),
            _ => {}
        }
    }
    if b.random.index(6) == 0 && street.may_be_shut() {
        let along = 0.5 * PITCH;
        let half = b.random.index(2) as f64 * b.random.range(1.2, 3.0);
        let gate = b.random.range(-5.0, 5.0);
        street.wall(b, [along, -HALF], [along + WALL, gate - half], 4.0);
        street.wall(b, [along, gate + half], [along + WALL, HALF], 4.0);
    }
}
