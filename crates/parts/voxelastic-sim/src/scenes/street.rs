//! The street: a block of houses of 90 x 60 m with houses all around, parked cars, trees, lamps and signs. A car drives around
//! it, lap after lap.

use super::albedo;
use super::facade::{Facade, RECESS};
use crate::WorldBuilder;
use crate::route::{Carrier, Route};
use std::f64::consts::PI;

/// The block, metres.
const BLOCK: [f64; 2] = [90.0, 60.0];
/// Distance between the facades across the street, metres.
const WIDTH: f64 = 15.0;
/// Width of the pavement on either side, metres.
const PAVEMENT: f64 = 2.7;
/// Height of the kerb, metres.
const KERB: f64 = 0.12;

/// A side of the street: a line of facades with the street on its left.
struct Side {
    from: [f64; 2],
    to: [f64; 2],
}

impl Side {
    fn length(&self) -> f64 {
        (self.to[0] - self.from[0]).hypot(self.to[1] - self.from[1])
    }

    fn yaw(&self) -> f64 {
        (self.to[1] - self.from[1]).atan2(self.to[0] - self.from[0])
    }

    /// The point `along` the side and `out` into the street.
    fn at(&self, along: f64, out: f64) -> [f64; 2] {
        let (dx, dy) = ((self.to[0] - self.from[0]) / self.length(), (self.to[1] - self.from[1]) / self.length());
        [self.from[0] + dx * along - dy * out, self.from[1] + dy * along + dx * out]
    }
}

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    let [w, h] = BLOCK;
    let s = WIDTH;
    b.ground(0.0, albedo::PAVING);
    // The block is traversed clockwise and the houses opposite counter-clockwise, so that the street is always on the left.
    let inner = [[0.0, 0.0], [0.0, h], [w, h], [w, 0.0]];
    let outer = [[-s, -s], [w + s, -s], [w + s, h + s], [-s, h + s]];
    for corners in [inner, outer] {
        for k in 0..4 {
            let side = Side { from: corners[k], to: corners[(k + 1) % 4] };
            houses(b, &side, corners == outer);
            pavement(b, &side);
            parked(b, &side);
        }
    }
    // The inside of the block, which blocks the view through it.
    b.cuboid([3.0, 3.0, -0.5], [w - 3.0, h - 3.0, 8.0], albedo::STONE);
    let (low, high) = (-s / 2.0, [w + s / 2.0, h + s / 2.0]);
    (Route::rounded(&[[low, low], [high[0], low], [high[0], high[1]], [low, high[1]]], 6.0), Carrier::CAR)
}

/// Houses of random width and height along a side, with some alleys on the outer side of the street.
fn houses(b: &mut WorldBuilder, side: &Side, alleys: bool) {
    let length = side.length();
    let mut start = 0.0;
    while length - start > 1.0 {
        let width = b.random.range(11.0, 19.0);
        let end = if length - start - width < 9.0 { length } else { start + width };
        let height = b.random.range(8.0, 15.0);
        let storeys = (height / 3.6) as usize;
        let bay = b.random.range(2.8, 4.2);
        let pilasters = if b.random.index(2) == 0 { b.random.range(0.1, 0.25) } else { 0.0 };
        let door = b.random.range(0.25, 0.75) * (end - start);
        let gates = vec![[door - 0.6, door + 0.6, 2.3]];
        Facade { from: side.at(start, 0.0), to: side.at(end, 0.0), height, storeys, bay, pilasters, gates }.add(b);
        let (near, far) = (side.at(start + 0.05, -RECESS), side.at(end - 0.05, -10.0));
        b.cuboid([near[0], near[1], -0.5], [far[0], far[1], height], albedo::GLASS);
        // Chimneys and a back ridge that stands above the cornice.
        let (near, far) = (side.at(start + 0.5, -3.0), side.at(end - 0.5, -7.0));
        b.cuboid([near[0], near[1], height - 1.0], [far[0], far[1], height + 2.0], albedo::WOOD);
        let alley = alleys && b.random.index(3) == 0 && end < length - 12.0;
        start = end + if alley { 3.0 } else { 0.0 };
    }
}

fn pavement(b: &mut WorldBuilder, side: &Side) {
    let length = side.length();
    let (near, far) = (side.at(-0.5, -0.5), side.at(length + 0.5, PAVEMENT));
    b.cuboid([near[0], near[1], -0.3], [far[0], far[1], KERB], albedo::PAVING * 1.3);
    let mut along = 6.0;
    while along < length - 5.0 {
        let at = side.at(along, PAVEMENT - 0.5);
        match b.random.index(5) {
            0 | 1 => {
                let scale = b.random.range(0.75, 1.0);
                b.tree(at, scale);
            }
            2 => b.lamp(at, side.yaw() + PI / 2.0),
            3 => b.sign(at, side.yaw()),
            _ => {
                b.bollard(at);
                b.bollard(side.at(along + 1.5, PAVEMENT - 0.5));
                b.column([at[0], at[1] + 0.001, 0.0], 0.5, 0.25, albedo::IRON);
            }
        }
        along += b.random.range(6.0, 9.0);
    }
}

fn parked(b: &mut WorldBuilder, side: &Side) {
    let mut along = 12.0;
    while along < side.length() - 12.0 {
        if b.random.index(3) > 0 {
            let at = side.at(along, PAVEMENT + 1.15 + b.random.range(-0.1, 0.15));
            let yaw = side.yaw() + b.random.range(-0.03, 0.03) + if b.random.index(2) == 0 { PI } else { 0.0 };
            b.car(at, yaw);
        }
        along += b.random.range(5.6, 6.6);
    }
}
