//! Follows the floor from below the sensor's way to all that is connected with it.

use crate::cells::{AROUND, Cells};
use crate::levels::{Level, Levels};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Where the floor rises or falls by no more than this to the next cell, it goes on: a step of a staircase, metres.
pub(crate) const FOLLOWED_STEP: f32 = 0.3;
/// Gaps of the floor up to this width are passed, metres: far from the sensor it is seen in rings.
const PASSED_GAP: f64 = 0.5;
/// The floor under a sensor is looked for this far to the side, metres: straight below it is seen only from elsewhere.
const ASIDE: f64 = 1.5;
/// The same while the sensor has not come to where it saw the floor: the lowest beams of a lidar on a car meet it some metres ahead.
const FAR_ASIDE: f64 = 10.0;
/// How far below the sensor the floor is at most, metres.
const MOST_DEPTH: f64 = 20.0;
/// The floor is as far below the sensor as it mostly is, plus or minus this, metres.
const USUAL: f64 = 0.5;
/// A foot is as large as this around its middle, metres; heights around it differ by no more than [`EVEN`], or a slope of [`STEEPEST`] in larger cells, on at least [`EVEN_SHARE`] of what is within [`NEAR`] of its height.
const FOOT: f64 = 0.13;
const EVEN: f32 = 0.1;
const STEEPEST: f64 = 0.8;
const NEAR: f32 = 0.5;
const EVEN_SHARE: f64 = 0.4;
/// A floor has at least this much space above it, metres.
const LEAST_HEADROOM: f32 = 0.3;

/// Calls `visit` with the levels beside a level that the floor goes on to, of those that `may_be` floor.
pub(crate) fn neighbours(levels: &Levels, cells: &Cells, may_be: &[bool], (cell, height): (usize, f32), mut visit: impl FnMut(usize)) {
    let reach = cells.reach(PASSED_GAP);
    for [dx, dy] in AROUND {
        for step in 1..=reach {
            let Some(beside) = cells.beside(cell, [dx * step, dy * step]) else { break };
            let mut found = false;
            for k in levels.of_cell(beside) {
                if may_be[k] && (levels.all()[k].height - height).abs() <= FOLLOWED_STEP {
                    found = true;
                    visit(k);
                }
            }
            if found {
                break;
            }
        }
    }
}

/// The levels under the sensor at each of `places`, and how far below.
///
/// Straight below, the floor is as far down as it is under most places. Where it was not seen there, it is the level nearest to that depth in the nearest cell that has one:
/// not a table that the sensor passes. As long as it was seen straight below nowhere, it is as far down as the lowest level in the nearest cells that have any.
pub(crate) fn levels_below(levels: &Levels, cells: &Cells, places: &[[f64; 3]]) -> Vec<Option<usize>> {
    let depth = |p: &[f64; 3], k: usize| p[2] - f64::from(levels.all()[k].height);
    let may_be = |p: &[f64; 3], k: &usize| (0.0..=MOST_DEPTH).contains(&depth(p, *k)) && levels.all()[*k].headroom >= LEAST_HEADROOM;
    let straight = |p: &[f64; 3]| levels.of_cell(cells.at([p[0], p[1]])?).rev().find(|k| may_be(p, k));
    let ring = |r: i32| (-r..=r).flat_map(move |x| (-r..=r).map(move |y| [x, y])).filter(move |c| c[0].abs().max(c[1].abs()) == r);
    let in_ring = |p: &[f64; 3], cell: usize, r: i32| -> Vec<usize> {
        ring(r).filter_map(|by| cells.beside(cell, by)).flat_map(|cell| levels.of_cell(cell)).filter(|k| may_be(p, k)).collect()
    };
    let far = cells.reach(FAR_ASIDE);
    let lowest_beside = |p: &[f64; 3]| {
        let cell = cells.at([p[0], p[1]])?;
        let nearest = (1..=far).map(|r| in_ring(p, cell, r)).find(|found| !found.is_empty())?;
        nearest.into_iter().max_by(|a, b| depth(p, *a).total_cmp(&depth(p, *b)))
    };
    let median = |mut depths: Vec<f64>| {
        depths.sort_unstable_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied()
    };
    let depths = |level: &dyn Fn(&[f64; 3]) -> Option<usize>| places.iter().filter_map(|p| Some(depth(p, level(p)?))).collect();
    let (usual, reach) = match median(depths(&straight)) {
        Some(usual) => (usual, cells.reach(ASIDE)),
        None => match median(depths(&lowest_beside)) {
            Some(usual) => (usual, far),
            None => return vec![None; places.len()],
        },
    };
    let find = |p: &[f64; 3]| {
        let off = |k: &usize| (depth(p, *k) - usual).abs();
        let cell = cells.at([p[0], p[1]])?;
        let of_ring = |r: i32| in_ring(p, cell, r).into_iter().filter(|k| off(k) <= USUAL).min_by(|a, b| off(a).total_cmp(&off(b)));
        (0..=reach).find_map(of_ring).or_else(|| straight(p))
    };
    places.iter().map(find).collect()
}

/// Which levels a foot finds hold on: among the levels around them, enough are as high. So steps of a staircase are, and what sticks out of a wall is not.
fn footholds(levels: &Levels, cells: &Cells, cell_of: &[u32]) -> Vec<bool> {
    let reach = cells.reach(FOOT);
    let even_within = EVEN.max((STEEPEST * f64::from(reach) * cells.edge) as f32);
    let around: Vec<[i32; 2]> = (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| [x, y])).collect();
    let is_foothold = |k: usize| {
        let Level { height, headroom, .. } = levels.all()[k];
        if headroom < LEAST_HEADROOM {
            return false;
        }
        let near = around.iter().filter_map(|by| cells.beside(cell_of[k] as usize, *by)).flat_map(|cell| levels.of_cell(cell));
        let (mut all, mut even) = (0, 0);
        for other in near {
            let off = (levels.all()[other].height - height).abs();
            all += usize::from(off <= NEAR);
            even += usize::from(off <= even_within);
        }
        even > reach as usize && even as f64 >= EVEN_SHARE * all as f64
    };
    (0..levels.all().len()).into_par_iter().map(is_foothold).collect()
}

/// Which levels are floor: those on which there is hold and that are connected with one of `seeds`.
pub(crate) fn reached(levels: &Levels, cells: &Cells, seeds: &[usize]) -> Vec<bool> {
    let cell_of = levels.cells();
    let footholds = footholds(levels, cells, &cell_of);
    let mut is_reached = vec![false; levels.all().len()];
    let mut queue = VecDeque::new();
    for &seed in seeds {
        if !std::mem::replace(&mut is_reached[seed], true) {
            queue.push_back(seed);
        }
    }
    while let Some(k) = queue.pop_front() {
        neighbours(levels, cells, &footholds, (cell_of[k] as usize, levels.all()[k].height), |other| {
            if !std::mem::replace(&mut is_reached[other], true) {
                queue.push_back(other);
            }
        });
    }
    is_reached
}
