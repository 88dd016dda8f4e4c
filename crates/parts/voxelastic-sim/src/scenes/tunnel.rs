//! The tunnel: two yards with sheds and columns, joined by a straight tunnel of 300 m whose smooth walls say nothing about how far a car has
//! come in it. The car drives through, turns in the far yard, and comes back.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// Length of the tunnel, metres.
const LENGTH: f64 = 300.0;
/// Half its width and its height, metres.
const HALF_WIDTH: f64 = 6.0;
const HEIGHT: f64 = 6.0;
/// Depth and half the width of a yard, metres.
const YARD: [f64; 2] = [40.0, 25.0];
/// Distance of the lanes from the middle, metres.
const LANE: f64 = 2.0;

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    b.ground(0.0, albedo::PAVING);
    for side in [-1.0, 1.0] {
        b.cuboid([0.0, side * HALF_WIDTH, -0.5], [LENGTH, side * YARD[1], HEIGHT + 2.0], albedo::STONE);
    }
    b.cuboid([0.0, -HALF_WIDTH, HEIGHT], [LENGTH, HALF_WIDTH, HEIGHT + 2.0], albedo::STONE);
    for (end, out) in [(0.0, -1.0), (LENGTH, 1.0)] {
        yard(b, end, out);
    }
    let (from, to) = (-25.0, LENGTH + 25.0);
    let wide = 12.0;
    let corners = [
        [from, -wide],
        [from + 12.0, -wide],
        [from + 20.0, -LANE],
        [to - 20.0, -LANE],
        [to - 12.0, -wide],
        [to, -wide],
        [to, wide],
        [to - 12.0, wide],
        [to - 20.0, LANE],
        [from + 20.0, LANE],
        [from + 12.0, wide],
        [from, wide],
    ];
    (Route::rounded(&corners, 6.0), Carrier::CAR)
}

/// A walled yard before the portal at x = `end`; `out` is the sign of the way out of the tunnel.
fn yard(b: &mut WorldBuilder, end: f64, out: f64) {
    let far = end + out * YARD[0];
    b.cuboid([far, -YARD[1], -0.5], [far + out, YARD[1], 5.0], albedo::STONE);
    for side in [-1.0, 1.0] {
        b.cuboid([end, side * YARD[1], -0.5], [far, side * (YARD[1] + 1.0), 5.0], albedo::STONE);
        for k in 0..4 {
            let x = end + out * (6.0 + 9.0 * f64::from(k) + b.random.range(-2.0, 2.0));
            let y = side * b.random.range(18.0, 22.0);
            let size = [b.random.range(1.0, 3.5), b.random.range(1.0, 3.0), b.random.range(1.5, 4.0)];
            let yaw = b.random.range(0.0, 1.5);
            b.turned([x, y, size[2] / 2.0], size, yaw, albedo::WOOD);
        }
    }
    // Columns that the car drives around.
    for (depth, reach) in [(8.0, 0.3), (14.0, 6.0), (19.0, 6.0)] {
        let (y, radius) = (b.random.range(-reach, reach), b.random.range(0.2, 0.5));
        b.column([end + out * depth, y, 0.0], 4.0, radius, albedo::IRON);
    }
}
