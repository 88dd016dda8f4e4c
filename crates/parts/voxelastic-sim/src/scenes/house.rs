//! The house: two storeys of 12 x 9 m that are nearly alike, joined by stairs of 17 steps. Doors on the route are 1.2 m wide, the others 0.8 m.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// Outer edges of the rooms, metres.
const SIZE: [f64; 2] = [12.0, 9.0];
/// Height of the upper floor, and of the rooms.
const STOREY: f64 = 3.0;
const ROOM: f64 = 2.7;
/// Where the stairs are: along y, between these x.
const STAIRS: [[f64; 2]; 2] = [[6.3, 2.0], [7.5, 6.76]];
const STEPS: usize = 17;
/// Walls are as thick as this, metres.
const WALL: f64 = 0.2;
/// Height of the doors.
const DOOR: f64 = 2.05;

/// Twice through each storey's rooms: the room in the east, that in the south-west, the hall, up the stairs, the room in the north-west, the hall, the room in the east,
/// down again.
const CORNERS: [[f64; 2]; 34] = [
    [5.4, 1.0],
    [11.2, 1.0],
    [11.2, 8.0],
    [8.6, 8.0],
    [8.6, 1.0],
    [5.4, 1.0],
    [5.4, 2.2],
    [1.0, 2.2],
    [1.0, 3.6],
    [3.4, 3.6],
    [3.4, 2.2],
    [5.1, 2.2],
    [5.1, 7.9],
    [5.8, 7.9],
    [5.8, 1.0],
    [6.9, 1.0],
    [6.9, 7.4],
    [1.0, 7.4],
    [1.0, 5.6],
    [3.4, 5.6],
    [3.4, 7.4],
    [5.1, 7.4],
    [5.1, 1.0],
    [5.8, 1.0],
    [5.8, 7.8],
    [9.0, 7.8],
    [11.2, 7.8],
    [11.2, 1.2],
    [8.6, 1.2],
    [8.6, 7.8],
    [6.9, 7.8],
    [6.9, 6.0],
    [6.9, 3.0],
    [6.9, 1.0],
];

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    let [x, y] = SIZE;
    b.cuboid([-WALL, -WALL, -0.3], [x + WALL, y + WALL, 0.0], albedo::WOOD);
    slab(b);
    b.cuboid([-WALL, -WALL, STOREY + ROOM], [x + WALL, y + WALL, STOREY + ROOM + 0.3], albedo::PAINT);
    for (low, high) in
        [([-WALL, -WALL], [0.0, y + WALL]), ([x, -WALL], [x + WALL, y + WALL]), ([-WALL, -WALL], [x + WALL, 0.0]), ([-WALL, y], [x + WALL, y + WALL])]
    {
        b.cuboid([low[0], low[1], -0.3], [high[0], high[1], STOREY + ROOM + 0.3], albedo::PAINT);
    }
    // Doors in the walls west and east of the hall.
    rooms(b, 0.0, &[[1.6, 2.8], [6.0, 6.8]], [0.4, 1.6]);
    rooms(b, STOREY, &[[1.6, 2.4], [6.8, 8.0]], [7.2, 8.4]);
    stairs(b);
    furniture(b);
    (Route::rounded(&CORNERS, 0.45).over(climb()), Carrier::PEDESTRIAN)
}

/// The floor of the upper storey, open above the stairs.
fn slab(b: &mut WorldBuilder) {
    let ([x, y], [low, high]) = (SIZE, STAIRS);
    let (bottom, top) = (ROOM, STOREY);
    let parts = [
        ([-0.1, -0.1], [low[0], y + 0.1]),
        ([high[0], -0.1], [x + 0.1, y + 0.1]),
        ([low[0], -0.1], [high[0], low[1]]),
        ([low[0], high[1]], [high[0], y + 0.1]),
    ];
    parts.into_iter().for_each(|(from, to)| b.cuboid([from[0], from[1], bottom], [to[0], to[1], top], albedo::WOOD));
    // The railing beside the opening.
    b.cuboid([low[0] - 0.05, low[1] - 0.05, STOREY], [low[0], high[1], STOREY + 1.0], albedo::WOOD);
    b.cuboid([low[0] - 0.05, low[1] - 0.05, STOREY], [high[0], low[1], STOREY + 1.0], albedo::WOOD);
}

/// The inner walls of a storey, with doors in the wall west of the hall and one in the wall east of it.
fn rooms(b: &mut WorldBuilder, floor: f64, west: &[[f64; 2]], east: [f64; 2]) {
    wall(b, 4.3, floor, west);
    wall(b, 7.5, floor, &[east]);
    b.cuboid([-0.1, 4.5, floor - 0.1], [4.4, 4.6, floor + ROOM + 0.1], albedo::PAINT);
}

/// A wall along y with doors.
fn wall(b: &mut WorldBuilder, x: f64, floor: f64, doors: &[[f64; 2]]) {
    let mut from = -0.1;
    for [low, high] in doors.iter().copied().chain([[SIZE[1] + 0.1; 2]]) {
        b.cuboid([x, from, floor - 0.1], [x + WALL, low, floor + ROOM + 0.1], albedo::PAINT);
        if high > low {
            b.cuboid([x, low - 0.05, floor + DOOR], [x + WALL, high + 0.05, floor + ROOM + 0.1], albedo::PAINT);
        }
        from = high;
    }
}

fn stairs(b: &mut WorldBuilder) {
    let [low, high] = STAIRS;
    let (run, rise) = ((high[1] - low[1]) / STEPS as f64, STOREY / STEPS as f64);
    for k in 0..STEPS {
        let from = low[1] + k as f64 * run;
        b.cuboid([low[0], from, -0.1], [high[0], high[1], (k as f64 + 1.0) * rise], albedo::WOOD);
    }
}

/// Tables, boxes, a bar and beds, away from the route.
fn furniture(b: &mut WorldBuilder) {
    b.table([9.9, 4.5], 0.2);
    b.cuboid([9.7, 6.3, -0.1], [10.1, 6.7, 0.25], albedo::WOOD);
    b.capsule([9.4, 2.3, 0.4], [10.5, 2.5, 0.4], 0.03, albedo::IRON);
    b.cuboid([0.1, 8.2, -0.1], [2.0, 8.9, 1.9], albedo::WOOD);
    b.cuboid([9.4, 3.8, STOREY - 0.1], [10.4, 5.8, STOREY + 0.5], albedo::PAINT);
    b.cuboid([0.1, 0.1, STOREY - 0.1], [1.7, 2.2, STOREY + 0.5], albedo::PAINT);
}

/// The height of the floor as one walks: on the stairs the line over their edges, elsewhere that of the storey that one came to last.
fn climb() -> impl FnMut([f64; 2]) -> f64 {
    let [low, high] = STAIRS;
    let mut storey = 0.0;
    move |[x, y]| {
        if x <= low[0] || x >= high[0] {
            return storey;
        }
        let share = ((y - low[1]) / (high[1] - low[1])).clamp(0.0, 1.0);
        storey = if share > 0.5 { STOREY } else { 0.0 };
        share * STOREY
    }
}
