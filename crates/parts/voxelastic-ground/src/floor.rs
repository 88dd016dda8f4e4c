//! The floor of one storey: its height in every cell, seen or filled in.

use crate::cells::{AROUND, Cells};
use crate::floor_cell::{FloorCell, Known};
use crate::follow::FOLLOWED_STEP;
use crate::levels::Levels;
use crate::robot::Body;
use crate::slope;
use rayon::prelude::*;
use std::collections::VecDeque;

/// Gaps between two places where the floor was seen are filled up to this width, metres: under a sensor and far from it the floor is seen sparsely.
const FILLED_GAP: f64 = 1.0;
/// So far beyond the last place where the floor was seen, obstacles are looked for at its height, metres.
const BEYOND: f64 = 1.5;
/// A step is the difference of heights within this distance, metres.
const STRIDE: f64 = 0.125;
/// What is cut off by steps is floor if it is at least this large, square metres: else it is a box, or a step of a staircase.
const LEAST_FLOOR: f64 = 1.0;
/// Voxels are of the floor between two places if they are no farther from its height than this, metres.
const SAME_HEIGHT: f32 = 0.1;
/// How fast a height that was filled in becomes uncertain, metres per metre.
const DRIFT: f32 = 0.05;

/// The floor of a storey whose levels are `of_cell`, by cell.
pub(crate) fn floor(cells: &Cells, levels: &Levels, of_cell: &[Option<u32>], body: &Body) -> Vec<FloorCell> {
    let seen = |level: &Option<u32>| match level {
        Some(k) => {
            let level = &levels.all()[*k as usize];
            let known = if level.has_surface { Known::Seen } else { Known::No };
            FloorCell { height: level.height, sigma: level.sigma, top: level.top, headroom: level.headroom, known, ..FloorCell::NONE }
        }
        None => FloorCell::NONE,
    };
    let mut floor: Vec<FloorCell> = of_cell.iter().map(seen).collect();
    mark_steep(cells, &mut floor, body);
    remove_boxes(cells, &mut floor, body);
    fill_between(cells, &mut floor);
    fill_beyond(cells, &mut floor);
    floor.iter_mut().filter(|cell| cell.known == Known::No).for_each(|cell| *cell = FloorCell::NONE);
    floor
}

/// Marks the upper ends of steps, and slopes.
fn mark_steep(cells: &Cells, floor: &mut [FloorCell], body: &Body) {
    let reach = cells.reach(STRIDE);
    let offsets: Vec<[i32; 2]> = (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| [x, y])).filter(|c| *c != [0, 0]).collect();
    let difficulty = |cell: usize| {
        let here = floor[cell];
        if here.known != Known::Seen {
            return 0.0;
        }
        let others = offsets.iter().filter_map(|by| cells.beside(cell, *by)).map(|at| floor[at]).filter(|other| other.known == Known::Seen);
        let fall = others.fold(0.0, |most, other| f64::from(here.height - other.height).max(most));
        let slope = slope::even_slope(cells, floor, cell).unwrap_or(0.0);
        (fall / body.step.max(1e-3)).max(slope / body.slope.max(1e-3)) as f32
    };
    let found: Vec<f32> = (0..floor.len()).into_par_iter().map(difficulty).collect();
    floor.iter_mut().zip(found).for_each(|(cell, difficulty)| cell.difficulty = difficulty);
}

/// What no step leads to is no floor if it is small: the top of a box or a bush.
fn remove_boxes(cells: &Cells, floor: &mut [FloorCell], body: &Body) {
    let mut is_visited = vec![false; floor.len()];
    let reach = cells.reach(STRIDE);
    let least = (LEAST_FLOOR / (cells.edge * cells.edge)) as usize;
    for first in 0..floor.len() {
        if is_visited[first] || floor[first].known != Known::Seen || floor[first].is_steep() {
            continue;
        }
        is_visited[first] = true;
        let (mut part, mut next) = (vec![first], 0);
        while let Some(&cell) = part.get(next) {
            next += 1;
            for [dx, dy] in AROUND {
                // The rim of what is steep is passed where the heights allow: it may be noise.
                for step in 1..=reach {
                    let Some(other) = cells.beside(cell, [dx * step, dy * step]) else { break };
                    let is_same = floor[other].known == Known::Seen && !floor[other].is_steep();
                    if is_same && f64::from((floor[other].height - floor[cell].height).abs()) <= body.step {
                        if !std::mem::replace(&mut is_visited[other], true) {
                            part.push(other);
                        }
                        break;
                    }
                }
            }
        }
        if part.len() < least {
            part.iter().for_each(|cell| floor[*cell] = FloorCell::NONE);
        }
    }
}

/// Fills cells between two cells on opposite sides. Where there are voxels at that height, though no surface, the floor was seen.
fn fill_between(cells: &Cells, floor: &mut [FloorCell]) {
    let reach = cells.reach(FILLED_GAP);
    let seen = |cell: usize, by: [i32; 2]| {
        (1..=reach).find_map(|step| {
            let other = floor[cells.beside(cell, [by[0] * step, by[1] * step])?];
            (other.known == Known::Seen && !other.is_steep()).then_some((step, other))
        })
    };
    let fill = |cell: usize| {
        if floor[cell].known != Known::No {
            return None;
        }
        let pairs = AROUND[..2].iter().chain(&AROUND[4..6]).filter_map(|by| Some((seen(cell, *by)?, seen(cell, by.map(|c| -c))?)));
        let close = pairs.filter(|((a, one), (b, other))| a + b <= reach && (one.height - other.height).abs() <= FOLLOWED_STEP);
        let ((a, one), (b, other)) = close.min_by_key(|((a, _), (b, _))| a + b)?;
        let share = a as f32 / (a + b) as f32;
        let height = one.height + share * (other.height - one.height);
        let distance = a.min(b) as f32 * cells.edge as f32;
        let sigma = one.sigma.max(other.sigma).hypot(DRIFT * distance);
        let has_voxels = (floor[cell].height - height).abs() <= SAME_HEIGHT;
        Some(if has_voxels {
            FloorCell { height, sigma, known: Known::Seen, ..floor[cell] }
        } else {
            FloorCell { height, sigma, top: height, known: Known::Between, ..FloorCell::NONE }
        })
    };
    let filled: Vec<Option<FloorCell>> = (0..floor.len()).map(fill).collect();
    floor.iter_mut().zip(filled).for_each(|(cell, filled)| *cell = filled.unwrap_or(*cell));
}

/// Continues the floor from its border, each cell as high as the nearest.
fn fill_beyond(cells: &Cells, floor: &mut [FloorCell]) {
    let reach = cells.reach(BEYOND);
    let is_known = |cell: usize| matches!(floor[cell].known, Known::Seen | Known::Between) && !floor[cell].is_steep();
    let mut queue: VecDeque<(usize, i32)> = (0..floor.len()).filter(|cell| is_known(*cell)).map(|cell| (cell, 0)).collect();
    while let Some((cell, steps)) = queue.pop_front() {
        if steps == reach {
            continue;
        }
        for by in &AROUND[..4] {
            let Some(other) = cells.beside(cell, *by).filter(|other| floor[*other].known == Known::No) else { continue };
            let from = floor[cell];
            let sigma = from.sigma.hypot(DRIFT * cells.edge as f32);
            let beyond = from.beyond + cells.edge as f32;
            floor[other] = FloorCell { height: from.height, top: from.height, sigma, known: Known::Beyond, beyond, ..FloorCell::NONE };
            queue.push_back((other, steps + 1));
        }
    }
}
