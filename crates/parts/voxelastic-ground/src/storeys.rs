//! Storeys: the floor in sheets, of which each has one level at a place.

use crate::cells::Cells;
use crate::follow::neighbours;
use crate::levels::Levels;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// No storey.
pub(crate) const NO_STOREY: u16 = u16::MAX;
/// Floors are above each other where they are so over more than this area, square metres.
const ABOVE_EACH_OTHER: f64 = 3.0;
/// Heights that most of a floor has are at least this far apart, metres.
const APART: f64 = 1.8;
/// Heights are counted in bins of this, metres.
const BIN: f64 = 0.1;
/// A height counts if at least this area has it, square metres.
const LEAST_AREA: f64 = 2.0;
/// Cost of a metre along the floor; one of a metre up or down is 1.
const ALONG: f64 = 0.01;
/// A storey that no sensor was on is at least this large, square metres.
const LEAST_STOREY: f64 = 10.0;
/// Most storeys.
const MOST: usize = 1000;

/// The storey of each level, from the lowest up; none of levels that are no floor. Every storey has at most one level in a cell.
pub(crate) fn storeys(levels: &Levels, cells: &Cells, is_floor: &[bool], seeds: &[usize]) -> (Vec<u16>, usize) {
    let cell_of = levels.cells();
    let overlap = area_twice(levels, cells, is_floor);
    let parts = if overlap > ABOVE_EACH_OTHER {
        let heights = usual_heights(levels, cells, is_floor);
        spread(levels, cells, &cell_of, is_floor, &heights)
    } else {
        is_floor.iter().map(|floor| if *floor { 0 } else { NO_STOREY }).collect()
    };
    let mut of_level = joined(cells, &cell_of, parts);
    drop_small(cells, seeds, &mut of_level);
    keep_one(levels, cells, &mut of_level);
    in_order(levels, of_level)
}

/// Area on which there is floor above floor, square metres.
fn area_twice(levels: &Levels, cells: &Cells, is_floor: &[bool]) -> f64 {
    let twice = (0..cells.count()).filter(|cell| levels.of_cell(*cell).filter(|k| is_floor[*k]).count() > 1).count();
    twice as f64 * cells.edge * cells.edge
}

/// Heights that much of the floor has, the most frequent first, each at least [`APART`] from the others.
fn usual_heights(levels: &Levels, cells: &Cells, is_floor: &[bool]) -> Vec<f64> {
    let mut bins: BTreeMap<i64, usize> = BTreeMap::new();
    for (level, _) in levels.all().iter().zip(is_floor).filter(|(_, floor)| **floor) {
        *bins.entry((f64::from(level.height) / BIN).floor() as i64).or_default() += 1;
    }
    // With the bins beside it, as a floor may be on the border of two.
    let around = |bin: i64| (bin - 1..=bin + 1).filter_map(|b| bins.get(&b)).sum::<usize>();
    let mut counts: Vec<(usize, i64)> = bins.keys().map(|bin| (around(*bin), *bin)).collect();
    counts.sort_unstable_by_key(|(count, bin)| (Reverse(*count), *bin));
    let mut heights: Vec<f64> = Vec::new();
    for (count, bin) in counts {
        let height = (bin as f64 + 0.5) * BIN;
        let is_large = count as f64 * cells.edge * cells.edge >= LEAST_AREA;
        if is_large && heights.len() < MOST && heights.iter().all(|h| (h - height).abs() >= APART) {
            heights.push(height);
        }
    }
    heights
}

/// Gives each level of the floor to one of `heights`: the one from which the least way up and down leads to it.
fn spread(levels: &Levels, cells: &Cells, cell_of: &[u32], is_floor: &[bool], heights: &[f64]) -> Vec<u16> {
    let mut of_level = vec![NO_STOREY; levels.all().len()];
    let mut costs = vec![f32::INFINITY; levels.all().len()];
    let mut queue = BinaryHeap::new();
    for (k, level) in levels.all().iter().enumerate().filter(|(k, _)| is_floor[*k]) {
        let near = heights.iter().position(|h| (h - f64::from(level.height)).abs() <= 1.5 * BIN);
        if let Some(part) = near {
            (of_level[k], costs[k]) = (part as u16, 0.0);
            queue.push(Reverse((0u32, k)));
        }
    }
    while let Some(Reverse((cost, k))) = queue.pop() {
        let cost = f32::from_bits(cost);
        if cost > costs[k] {
            continue;
        }
        let (height, part) = (levels.all()[k].height, of_level[k]);
        neighbours(levels, cells, is_floor, (cell_of[k] as usize, height), |other| {
            let rise = (levels.all()[other].height - height).abs();
            let next = cost + rise + (ALONG * cells.edge) as f32;
            if next < costs[other] {
                (of_level[other], costs[other]) = (part, next);
                // Positive numbers are in the order of their bits.
                queue.push(Reverse((next.to_bits(), other)));
            }
        });
    }
    // What is connected with none of them, as a small floor by itself, is one more.
    let rest = heights.len() as u16;
    of_level.iter_mut().zip(is_floor).filter(|(part, floor)| **floor && **part == NO_STOREY).for_each(|(part, _)| *part = rest);
    of_level
}

/// Joins parts that are nowhere above each other, the largest first: a hill is one storey, whatever its heights.
fn joined(cells: &Cells, cell_of: &[u32], parts: Vec<u16>) -> Vec<u16> {
    let count = parts.iter().filter(|p| **p != NO_STOREY).max().map_or(0, |p| usize::from(*p) + 1);
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); count];
    for (part, cell) in parts.iter().zip(cell_of).filter(|(part, _)| **part != NO_STOREY) {
        members[usize::from(*part)].push(*cell);
    }
    let mut order: Vec<usize> = (0..count).filter(|part| !members[*part].is_empty()).collect();
    order.sort_by_key(|part| (Reverse(members[*part].len()), *part));
    let mut groups: Vec<Vec<bool>> = Vec::new();
    let mut group_of = vec![NO_STOREY; count];
    let most = ABOVE_EACH_OTHER / (cells.edge * cells.edge);
    for part in order {
        let fits = |group: &Vec<bool>| members[part].iter().filter(|cell| group[**cell as usize]).count() as f64 <= most;
        let group = groups.iter().position(fits).unwrap_or_else(|| {
            groups.push(vec![false; cells.count()]);
            groups.len() - 1
        });
        members[part].iter().for_each(|cell| groups[group][*cell as usize] = true);
        group_of[part] = group as u16;
    }
    parts.into_iter().map(|part| if part == NO_STOREY { NO_STOREY } else { group_of[usize::from(part)] }).collect()
}

/// What no sensor was on is no storey if it is small: a ledge, a balcony.
fn drop_small(cells: &Cells, seeds: &[usize], of_level: &mut [u16]) {
    let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
    of_level.iter().for_each(|storey| *counts.entry(*storey).or_default() += 1);
    let least = LEAST_STOREY / (cells.edge * cells.edge);
    let is_kept = |storey: u16| counts.get(&storey).is_some_and(|count| *count as f64 >= least) || seeds.iter().any(|k| of_level[*k] == storey);
    let dropped: Vec<u16> = counts.keys().copied().filter(|storey| !is_kept(*storey)).collect();
    of_level.iter_mut().filter(|storey| dropped.contains(*storey)).for_each(|storey| *storey = NO_STOREY);
}

/// Where a storey has several levels in a cell, it keeps the one with the most room above it, the lowest of equals.
fn keep_one(levels: &Levels, cells: &Cells, of_level: &mut [u16]) {
    for cell in 0..cells.count() {
        let here = levels.of_cell(cell);
        if here.len() < 2 {
            continue;
        }
        for k in here.clone() {
            let (storey, headroom) = (of_level[k], levels.all()[k].headroom);
            let is_worse = |other: usize| {
                let room = levels.all()[other].headroom;
                other != k && of_level[other] == storey && (room > headroom || (room == headroom && other < k))
            };
            if storey != NO_STOREY && here.clone().any(is_worse) {
                of_level[k] = NO_STOREY;
            }
        }
    }
}

/// Numbers storeys from the lowest median height up.
fn in_order(levels: &Levels, of_level: Vec<u16>) -> (Vec<u16>, usize) {
    let mut heights: BTreeMap<u16, Vec<f32>> = BTreeMap::new();
    for (storey, level) in of_level.iter().zip(levels.all()).filter(|(storey, _)| **storey != NO_STOREY) {
        heights.entry(*storey).or_default().push(level.height);
    }
    let mut medians: Vec<(f32, u16)> = heights.into_iter().map(|(storey, mut all)| (median(&mut all), storey)).collect();
    medians.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let number: BTreeMap<u16, u16> = medians.iter().enumerate().map(|(k, (_, storey))| (*storey, k as u16)).collect();
    let count = number.len();
    (of_level.into_iter().map(|storey| number.get(&storey).copied().unwrap_or(NO_STOREY)).collect(), count)
}

fn median(all: &mut [f32]) -> f32 {
    let middle = all.len() / 2;
    *all.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::connections::connections;
    use crate::follow::reached;

    const CELLS: Cells = Cells { edge: 0.25, low: [0, 0], size: [60, 40] };

    /// The storey of each level by the heights of cells, given at their middles, followed from the first level.
    fn divided(heights: impl Fn([f64; 2]) -> Vec<f32>) -> (Levels, Vec<u16>, usize) {
        let levels = Levels::at(&(0..CELLS.count()).map(|cell| heights(CELLS.centre(cell))).collect::<Vec<_>>());
        let is_floor = reached(&levels, &CELLS, &[0]);
        let (of_level, count) = storeys(&levels, &CELLS, &is_floor, &[0]);
        (levels, of_level, count)
    }

    /// A floor at 0, a gallery at 3 m above its northern part, and a ramp beside them from one to the other.
    fn gallery([x, y]: [f64; 2]) -> Vec<f32> {
        let is_below = (y > 9.0 && x > 12.0) || (y > 7.0 && x <= 12.0);
        match (x > 13.0, is_below) {
            (true, _) => vec![(0.3 * y) as f32],
            (false, true) => vec![0.0, 3.0],
            (false, false) => vec![0.0],
        }
    }

    #[test]
    fn floors_above_each_other_are_storeys_and_a_ramp_is_cut_in_its_middle() {
        let (levels, of_level, count) = divided(gallery);
        assert_eq!(count, 2);
        for cell in 0..CELLS.count() {
            let [x, y] = CELLS.centre(cell);
            for k in levels.of_cell(cell) {
                let height = levels.all()[k].height;
                // In the middle of the ramp is the border.
                if x <= 13.0 || (height - 1.5).abs() > 0.2 {
                    assert_eq!(of_level[k], u16::from(height > 1.5), "({x}, {y}), {height}");
                }
            }
        }
        let places = connections(&levels, &CELLS, &of_level);
        assert_eq!(places.len(), 1, "{places:?}");
        assert!(places[0].storeys == [0, 1] && (places[0].at[2] - 1.5).abs() < 0.3 && places[0].at[0] > 13.0, "{places:?}");
    }

    #[test]
    fn a_hill_is_one_storey_however_high() {
        let (_, of_level, count) = divided(|[x, y]| vec![(0.6 * x + 0.2 * y) as f32]);
        assert_eq!((count, of_level.iter().all(|storey| *storey == 0)), (1, true));
    }

    #[test]
    fn tables_are_not_reached() {
        let (levels, of_level, count) = divided(|[x, y]| if (x - 5.0).hypot(y - 5.0) < 1.0 { vec![0.0, 0.75] } else { vec![0.0] });
        assert_eq!(count, 1);
        let on_table = |k: usize| levels.all()[k].height > 0.5;
        assert!((0..of_level.len()).all(|k| (of_level[k] == NO_STOREY) == on_table(k)));
    }
}
