//! The campus: a college quad (pilasters, window recesses, a colonnade), a tunnel of 3 m out of it into a park with trees and
//! railings, a doorway of 1 m in the park's wall and a passage back. 135 x 225 m.

use super::albedo;
use super::facade::{Facade, RECESS, mass};
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// Once round the court, through the tunnel (x = 47.5), round the park and back by doorway and passage (x = 101.5): 357 m.
const CORNERS: [[f64; 2]; 15] = [
    [60.0, 32.0],
    [44.0, 32.0],
    [38.0, 48.0],
    [38.0, 70.0],
    [47.5, 82.0],
    [47.5, 128.0],
    [42.0, 140.0],
    [46.0, 160.0],
    [66.0, 172.0],
    [90.0, 168.0],
    [101.5, 152.0],
    [101.5, 78.0],
    [94.0, 58.0],
    [92.0, 40.0],
    [80.0, 32.0],
];

/// The court, between the fronts.
const COURT: [[f64; 2]; 2] = [[25.0, 20.0], [110.0, 95.0]];
/// The tunnel under the gatehouse, x and y.
const TUNNEL: [[f64; 2]; 2] = [[46.0, 95.0], [49.0, 120.0]];
/// The passage through the north range.
const PASSAGE: [[f64; 2]; 2] = [[100.0, 95.0], [103.0, 110.0]];
const TUNNEL_HEIGHT: f64 = 3.4;

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    let route = Route::rounded(&CORNERS, 5.0);
    b.ground(0.0, albedo::PAVING);
    ranges(b);
    gatehouse(b);
    fronts(b);
    court(b);
    forecourt(b);
    park(b, &route);
    (route, Carrier::PEDESTRIAN)
}

/// The four wings around the court.
fn ranges(b: &mut WorldBuilder) {
    mass(b, [10.0, 5.0], [125.0, 20.0], 12.0);
    mass(b, [10.0, 5.0], [25.0, 110.0], 12.0);
    mass(b, [110.0, 5.0], [125.0, 110.0], 12.0);
    // The north range in three parts, with plain walls along tunnel and passage, and the bridge over the passage.
    let (low, high) = (95.0 + RECESS, 110.0 - RECESS);
    b.cuboid([12.0, low, -0.5], [TUNNEL[0][0], high, 10.0], albedo::STONE);
    b.cuboid([TUNNEL[1][0], low, -0.5], [PASSAGE[0][0], high, 10.0], albedo::STONE);
    b.cuboid([PASSAGE[1][0], low, -0.5], [123.0, high, 10.0], albedo::STONE);
    b.cuboid([PASSAGE[0][0] - 0.5, low, 3.2], [PASSAGE[1][0] + 0.5, high, 10.0], albedo::STONE);
}

/// The tower over the tunnel, with ribs and lamps inside.
fn gatehouse(b: &mut WorldBuilder) {
    let (west, east) = (TUNNEL[0][0], TUNNEL[1][0]);
    let (low, high) = (95.0 + RECESS, 120.0 - RECESS);
    b.cuboid([40.0 + RECESS, low, -0.5], [west, high, 18.0], albedo::STONE);
    b.cuboid([east, low, -0.5], [55.0 - RECESS, high, 18.0], albedo::STONE);
    b.cuboid([west - 0.5, low, TUNNEL_HEIGHT], [east + 0.5, high, 18.0], albedo::STONE);
    for k in 0..6 {
        let y = 96.5 + 4.2 * f64::from(k);
        b.cuboid([west - 0.1, y, -0.1], [west + 0.15, y + 0.5, TUNNEL_HEIGHT + 0.1], albedo::TRIM);
        b.cuboid([east - 0.15, y, -0.1], [east + 0.1, y + 0.5, TUNNEL_HEIGHT + 0.1], albedo::TRIM);
        b.cuboid([west - 0.1, y, TUNNEL_HEIGHT - 0.2], [east + 0.1, y + 0.5, TUNNEL_HEIGHT + 0.1], albedo::TRIM);
        b.sphere([47.5, y + 2.3, TUNNEL_HEIGHT - 0.1], 0.18, albedo::PAINT);
    }
    // Corner turrets.
    for (x, y) in [(40.3, 119.7), (54.7, 119.7)] {
        b.column([x, y, -0.5], 20.0, 1.2, albedo::STONE);
    }
}

fn fronts(b: &mut WorldBuilder) {
    let [[x0, y0], [x1, y1]] = COURT;
    let front = |from, to, height, storeys| Facade { from, to, height, storeys, bay: 4.0, pilasters: 0.25, gates: Vec::new() };
    let gate = |along: f64| [along, along + 3.0, TUNNEL_HEIGHT];
    // Inside the court the left side of a counter-clockwise walk along the walls looks in.
    front([x0, y0], [x1, y0], 12.0, 3).add(b);
    front([x1, y0], [x1, y1], 12.0, 3).add(b);
    let north = vec![gate(x1 - PASSAGE[1][0]), gate(x1 - TUNNEL[1][0])];
    Facade { gates: north, ..front([x1, y1], [x0, y1], 10.0, 3) }.add(b);
    front([x0, y1], [x0, y0], 12.0, 3).add(b);
    // Towards park and forecourt.
    front([10.0, 110.0], [40.0, 110.0], 10.0, 3).add(b);
    let north = vec![gate(PASSAGE[0][0] - 55.0)];
    Facade { gates: north, ..front([55.0, 110.0], [125.0, 110.0], 10.0, 3) }.add(b);
    let tower = vec![gate(TUNNEL[0][0] - 40.0)];
    Facade { gates: tower, bay: 7.5, ..front([40.0, 120.0], [55.0, 120.0], 18.0, 4) }.add(b);
    front([55.0, 120.0], [55.0, 110.0], 18.0, 4).add(b);
    front([40.0, 110.0], [40.0, 120.0], 18.0, 4).add(b);
}

/// Colonnade, lawns, fountain, benches and lamps.
fn court(b: &mut WorldBuilder) {
    let x = COURT[0][0] + 3.4;
    b.cuboid([COURT[0][0] - 0.2, 24.0, 4.1], [x + 0.45, 91.0, 4.6], albedo::TRIM);
    for k in 0..17 {
        let y = 25.5 + 4.0 * f64::from(k);
        b.column([x, y, -0.1], 4.3, 0.26, albedo::TRIM);
        b.cuboid([x - 0.4, y - 0.4, -0.1], [x + 0.4, y + 0.4, 0.35], albedo::STONE);
        b.cuboid([x - 0.36, y - 0.36, 3.8], [x + 0.36, y + 0.36, 4.2], albedo::STONE);
    }
    for (low, high) in [([46.0, 38.0], [64.0, 54.0]), ([70.0, 38.0], [86.0, 54.0]), ([46.0, 61.0], [64.0, 74.0]), ([70.0, 61.0], [86.0, 74.0])] {
        b.cuboid([low[0], low[1], -0.2], [high[0], high[1], 0.09], albedo::GRASS);
    }
    b.column([67.0, 57.5, -0.2], 0.8, 3.2, albedo::STONE);
    b.column([67.0, 57.5, -0.2], 2.9, 0.4, albedo::STONE);
    b.column([67.0, 57.5, 1.7], 0.2, 1.4, albedo::STONE);
    b.sphere([67.0, 57.5, 3.1], 0.6, albedo::TRIM);
    for k in 0..5 {
        let x = 48.0 + 9.0 * f64::from(k);
        b.bench([x, 22.2], std::f64::consts::PI);
        b.lamp([x + 4.0, 77.5], 1.6);
    }
    b.tree([78.0, 46.0], 1.1);
    b.tree([54.0, 67.0], 1.2);
    b.tree([80.0, 68.0], 0.9);
}

/// Between north range and garden wall: the doorway of 1 m, bollards, a railing.
fn forecourt(b: &mut WorldBuilder) {
    let (west, east, y) = (60.0, 130.0, 135.0);
    let thick = 0.25;
    let door = [101.0, 102.0];
    b.cuboid([west - thick, y - thick, -0.5], [door[0], y + thick, 2.8], albedo::STONE);
    b.cuboid([door[1], y - thick, -0.5], [east, y + thick, 2.8], albedo::STONE);
    b.cuboid([door[0] - 0.3, y - thick, 2.25], [door[1] + 0.3, y + thick, 2.8], albedo::STONE);
    b.cuboid([west - thick, 110.0 - 0.2, -0.5], [west + thick, y + thick, 2.8], albedo::STONE);
    b.cuboid([west - 0.4, y - 0.4, 2.8], [east, y + 0.4, 2.95], albedo::TRIM);
    for k in 0..9 {
        // Piers in front of the wall.
        let x = 66.0 + 7.5 * f64::from(k);
        b.cuboid([x, y - 0.5, -0.2], [x + 0.6, y + 0.5, 3.1], albedo::TRIM);
    }
    for k in 0..12 {
        let x = 68.0 + 4.5 * f64::from(k);
        if !(98.5..104.5).contains(&x) {
            b.bollard([x, 122.0]);
        }
    }
    b.railing([64.0, 114.0], [94.0, 114.0]);
    b.tree([72.0, 128.0], 1.0);
    b.tree([86.0, 127.0], 1.2);
    b.tree([115.0, 126.0], 1.1);
    b.cuboid([125.0 - RECESS, 108.0, -0.5], [126.0, 135.5, 4.0], albedo::STONE);
}

fn park(b: &mut WorldBuilder, route: &Route) {
    // Its bounds: railings to the north, walls with piers elsewhere.
    b.railing([6.0, 222.0], [66.0, 222.0]);
    b.cuboid([66.0, 221.7, -0.5], [130.5, 222.3, 2.2], albedo::STONE);
    b.cuboid([129.7, 135.0, -0.5], [130.3, 222.3, 2.2], albedo::STONE);
    b.cuboid([5.4, 109.0, -0.5], [6.0, 222.3, 2.2], albedo::STONE);
    for k in 0..14 {
        let y = 142.0 + 5.6 * f64::from(k);
        b.cuboid([129.4, y, -0.2], [129.9, y + 0.5, 2.5], albedo::TRIM);
        b.cuboid([5.8, y, -0.2], [6.3, y + 0.5, 2.5], albedo::TRIM);
    }
    // A hill, a pavilion, railings along the path.
    b.sphere([30.0, 198.0, -18.7], 20.0, albedo::GRASS);
    let (cx, cy) = (76.0, 192.0);
    b.column([cx, cy, -0.2], 0.45, 4.2, albedo::STONE);
    b.column([cx, cy, 3.4], 0.5, 4.3, albedo::TRIM);
    b.sphere([cx, cy, 2.0], 3.2, albedo::TRIM);
    for k in 0..8 {
        let angle = std::f64::consts::TAU * f64::from(k) / 8.0;
        b.column([cx + 3.7 * angle.cos(), cy + 3.7 * angle.sin(), 0.0], 3.6, 0.2, albedo::TRIM);
    }
    b.railing([50.5, 124.0], [50.5, 139.0]);
    b.railing([50.5, 139.0], [58.0, 146.0]);
    for (x, y, yaw) in [(57.0, 175.0, 0.5), (86.0, 176.0, 6.0), (36.0, 150.0, 1.6), (107.0, 145.0, 4.7)] {
        b.bench([x, y], yaw);
    }
    for (x, y) in [(44.0, 126.0), (51.0, 158.0), (77.0, 163.0), (97.0, 150.0)] {
        b.lamp([x, y], 0.7);
    }
    for x in [42.5, 44.0, 45.5, 49.5] {
        b.bollard([x, 123.5]);
    }
    trees(b, route);
}

/// Trees at random, 6 m apart at least and away from path, buildings and pavilion.
fn trees(b: &mut WorldBuilder, route: &Route) {
    let mut placed: Vec<[f64; 2]> = vec![[76.0, 192.0]];
    for _ in 0..400 {
        let at = [b.random.range(10.0, 126.0), b.random.range(126.0, 218.0)];
        let in_forecourt = at[0] > 56.0 && at[1] < 139.0;
        let crowded = placed.iter().any(|q| (at[0] - q[0]).hypot(at[1] - q[1]) < 6.5);
        if placed.len() < 46 && !in_forecourt && !crowded && route.is_clear_of(at, 3.0) {
            placed.push(at);
            let scale = b.random.range(0.8, 1.5);
            b.tree(at, scale);
        }
    }
}
