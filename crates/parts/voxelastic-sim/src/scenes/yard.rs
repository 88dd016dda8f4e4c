//! The yard: a pavement with a kerb of 12 cm, two ramps to a platform of 0.8 m, and what a small robot must not run into: a table, a bar, a box of 25 cm. 26 x 16 m.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// Corners of the route: up one ramp, along the platform, down the other, over the kerb and back.
const CORNERS: [[f64; 2]; 6] = [[0.0, 3.5], [-10.0, 3.5], [-10.0, -3.5], [0.0, -3.5], [8.0, -3.5], [8.0, 3.5]];
/// Where the ramps begin and end along x, and how high they lead.
const RAMP: [f64; 2] = [-3.0, -8.0];
const PLATFORM: f64 = 0.8;
/// Where the pavement begins, and its height.
const KERB: [f64; 2] = [4.0, 0.12];
/// A ramp consists of steps of this height, metres.
const FINE: f64 = 0.005;

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    b.ground(0.0, albedo::PAVING);
    for (low, high) in [([-13.5, -8.5], [-13.0, 8.5]), ([13.0, -8.5], [13.5, 8.5]), ([-13.5, -8.5], [13.5, -8.0]), ([-13.5, 8.0], [13.5, 8.5])] {
        b.cuboid([low[0], low[1], -0.5], [high[0], high[1], 3.0], albedo::STONE);
    }
    b.cuboid([KERB[0], -8.2, -0.3], [13.2, 8.2, KERB[1]], albedo::PAVING * 1.3);
    b.cuboid([-12.0, -5.0, -0.3], [RAMP[1], 5.0, PLATFORM], albedo::STONE);
    [[2.0, 5.0], [-5.0, -2.0]].into_iter().for_each(|side| ramp(b, side));
    b.table([0.0, 0.0], 0.0);
    b.cuboid([1.5, 0.3, -0.1], [2.0, 0.8, 0.25], albedo::WOOD);
    b.cuboid([2.0, -1.3, -0.1], [2.5, -0.8, 0.05], albedo::WOOD);
    b.capsule([-2.0, -1.2, 0.35], [0.8, -1.6, 0.35], 0.04, albedo::IRON);
    b.column([2.6, 1.6, -0.1], 1.3, 0.06, albedo::IRON);
    let floor = |p: [f64; 2]| {
        let up = ((RAMP[0] - p[0]) / (RAMP[0] - RAMP[1])).clamp(0.0, 1.0) * PLATFORM;
        if p[0] > KERB[0] { KERB[1] } else { up }
    };
    (Route::rounded(&CORNERS, 1.5).over(floor), Carrier::ROBOT)
}

fn ramp(b: &mut WorldBuilder, [low, high]: [f64; 2]) {
    let steps = (PLATFORM / FINE).round();
    for k in 0..steps as usize {
        // Half a step on either side of the even slope.
        let (top, from) = ((k as f64 + 1.0) * FINE, RAMP[0] + (RAMP[1] - RAMP[0]) * (k as f64 + 0.5) / steps);
        b.cuboid([from, low, -0.3], [RAMP[1] - 0.05, high, top], albedo::PAVING);
    }
}
