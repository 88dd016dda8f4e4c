//! The maze: corridors 3.5 m wide under a ceiling, a tree of them with dead ends and a few loops, to explore.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// Cells along x and y.
const SIZE: [usize; 2] = [11, 8];
/// Edge of a cell, metres.
const CELL: f64 = 4.0;
/// Half the thickness of a wall, metres.
const HALF: f64 = 0.25;
const CEILING: f64 = 2.8;
/// Walls that are taken out after every cell can be reached, so that corridors meet again.
const LOOPS: usize = 5;

/// The walls between cells: `east[y][x]` between cell (x, y) and the next along x, `north` likewise along y.
struct Walls {
    east: [[bool; SIZE[0]]; SIZE[1]],
    north: [[bool; SIZE[0]]; SIZE[1]],
}

pub(super) fn build(b: &mut WorldBuilder) -> (Route, Carrier) {
    let walls = carve(b);
    b.ground(0.0, albedo::PAVING);
    let (low, high) = ([-0.5 * CELL; 2], [0, 1].map(|k| (SIZE[k] as f64 - 0.5) * CELL));
    b.cuboid([low[0] - 1.0, low[1] - 1.0, CEILING], [high[0] + 1.0, high[1] + 1.0, CEILING + 0.5], albedo::PAINT);
    for (a, c) in [
        ([low[0] - 1.0, low[1] - 1.0], [high[0] + 1.0, low[1] + HALF]),
        ([low[0] - 1.0, high[1] - HALF], [high[0] + 1.0, high[1] + 1.0]),
        ([low[0] - 1.0, low[1] - 1.0], [low[0] + HALF, high[1] + 1.0]),
        ([high[0] - HALF, low[1] - 1.0], [high[0] + 1.0, high[1] + 1.0]),
    ] {
        b.cuboid([a[0], a[1], -0.5], [c[0], c[1], CEILING + 0.5], albedo::STONE);
    }
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let centre = [x as f64 * CELL, y as f64 * CELL];
            let reach = 0.5 * CELL + HALF;
            if walls.east[y][x] && x + 1 < SIZE[0] {
                let face = centre[0] + 0.5 * CELL;
                b.cuboid([face - HALF, centre[1] - reach, -0.5], [face + HALF, centre[1] + reach, CEILING + 0.1], albedo::STONE);
            }
            if walls.north[y][x] && y + 1 < SIZE[1] {
                let face = centre[1] + 0.5 * CELL;
                b.cuboid([centre[0] - reach, face - HALF, -0.5], [centre[0] + reach, face + HALF, CEILING + 0.1], albedo::STONE);
            }
        }
    }
    (Route::rounded(&[], 1.0), Carrier::ROBOT)
}

/// Removes walls along a random depth-first walk through all cells, and a few more.
fn carve(b: &mut WorldBuilder) -> Walls {
    let mut walls = Walls { east: [[true; SIZE[0]]; SIZE[1]], north: [[true; SIZE[0]]; SIZE[1]] };
    let mut visited = [[false; SIZE[0]]; SIZE[1]];
    visited[0][0] = true;
    let mut stack = vec![[0usize; 2]];
    while let Some(&[x, y]) = stack.last() {
        let neighbours = [(x + 1, y), (x.wrapping_sub(1), y), (x, y + 1), (x, y.wrapping_sub(1))];
        let next: Vec<(usize, usize)> = neighbours.into_iter().filter(|(x, y)| *x < SIZE[0] && *y < SIZE[1] && !visited[*y][*x]).collect();
        if next.is_empty() {
            stack.pop();
            continue;
        }
        let (nx, ny) = next[b.random.index(next.len())];
        if nx == x {
            walls.north[y.min(ny)][x] = false
        } else {
            walls.east[y][x.min(nx)] = false
        }
        visited[ny][nx] = true;
        stack.push([nx, ny]);
    }
    for _ in 0..LOOPS {
        let (x, y) = (b.random.index(SIZE[0] - 1), b.random.index(SIZE[1] - 1));
        if b.random.uniform() < 0.5 { walls.east[y][x] = false } else { walls.north[y][x] = false }
    }
    walls
}
