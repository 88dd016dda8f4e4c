//! The nearest neighbours of every return.
//!
//! Returns are searched in cells that are about as wide as their neighbours are far: the candidates, those of the cell and of the 26 around it, are gathered
//! once for all returns of a cell. Where these do not contain enough within one edge, cells of the next size are searched.

use super::cells::{CellTable, EDGE, LEVELS};
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Least neighbours of a return, itself included. Fewer make planes uncertain, more smooth over edges.
pub(super) const LEAST: usize = 13;
/// Most neighbours: to find exactly so many would take longer.
pub(super) const MOST: usize = 16;
/// Cells with fewer returns are too small for a search.
const LEAST_IN_CELL: usize = 4;
/// Of more candidates, every second or third is tried.
const MOST_CANDIDATES: usize = 1024;
/// Returns of one task.
const CHUNK: usize = 1024;
/// Candidates are compared in groups of so many.
const LANES: usize = 16;

/// The nearest neighbours of each return.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbours {
    /// Room for [`MOST`] of each.
    all: Vec<[u32; MOST]>,
    found: Vec<Found>,
    table: CellTable,
}

/// What was found of one return.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    count: u32,
    /// Distance to the farthest neighbour, metres.
    reach: f32,
}

impl Neighbours {
    /// Finds the neighbours of all `points`, whose cells have the `keys`, sorted.
    pub(super) fn find(&mut self, points: &[[f32; 3]], keys: &[u64]) {
        let Self { all, found, table } = self;
        all.clear();
        all.resize(points.len(), [0; MOST]);
        found.clear();
        // Of returns that are alone, it is known that others are farther away than the largest cell is wide.
        found.resize(points.len(), Found { count: 0, reach: EDGE * (1 << LEVELS) as f32 });
        let mut pending: Vec<u32> = (0..points.len() as u32).collect();
        for level in 0..LEVELS {
            table.fill(keys, level);
            // Each task writes what it finds into a part of its own.
            let (mut rest, mut at) = ((&mut all[..], &mut found[..]), 0);
            let mut tasks = Vec::new();
            for pending in pending.chunks(CHUNK) {
                let end = pending[pending.len() - 1] as usize + 1;
                let parts = (rest.0.split_off_mut(..end - at), rest.1.split_off_mut(..end - at));
                if let (Some(all), Some(found)) = parts {
                    tasks.push(Task { points, keys, table, level, pending, first: at, all, found });
                }
                at = end;
            }
            let left: Vec<Vec<u32>> = tasks.into_par_iter().map(Task::run).collect();
            pending = left.concat();
        }
    }

    /// The neighbours of return `i`, itself among them, in no particular order; none if it is alone.
    pub(super) fn of(&self, i: usize) -> &[u32] {
        &self.all[i][..self.found[i].count as usize]
    }

    /// Adds the neighbours of the neighbours of return `i`, themselves included, each once, to `all`; `seen` has for each return the last one that has it.
    pub(super) fn of_neighbours(&self, i: u32, seen: &mut [u32], all: &mut Vec<u32>) {
        for &j in self.of(i as usize).iter().flat_map(|&j| self.of(j as usize)) {
            if seen[j as usize] != i {
                seen[j as usize] = i;
                all.push(j);
            }
        }
    }

    /// Distance between returns that are spread evenly over a surface as those around return `i` are, metres.
    pub(super) fn spacing(&self, i: usize) -> f32 {
        let Found { count, reach } = self.found[i];
        reach * (std::f32::consts::PI / count.max(1) as f32).sqrt()
    }
}

/// A search for the neighbours of some returns, in cells of one size.
struct Task<'a> {
    points: &'a [[f32; 3]],
    keys: &'a [u64],
    table: &'a CellTable,
    level: u32,
    pending: &'a [u32],
    /// The return to which the first entries of the following belong.
    first: usize,
    all: &'a mut [[u32; MOST]],
    found: &'a mut [Found],
}

impl Task<'_> {
    /// Finds what can be found; returns which returns need larger cells.
    fn run(self) -> Vec<u32> {
        let (mut left, mut candidates) = (Vec::new(), Candidates::default());
        let key = |i: u32| self.keys[i as usize] >> (3 * self.level);
        for group in self.pending.chunk_by(|&a, &b| key(a) == key(b)) {
            if self.level + 1 < LEVELS && self.table.get(key(group[0])).len() < LEAST_IN_CELL {
                left.extend_from_slice(group);
                continue;
            }
            let around = self.table.around(key(group[0]));
            let count: usize = around.iter().map(|range| range.len()).sum();
            if count < LEAST {
                left.extend_from_slice(group);
                continue;
            }
            candidates.gather(self.points, &around, count.div_ceil(MOST_CANDIDATES));
            dispatch(Search {
                points: self.points,
                candidates: &mut candidates,
                group,
                edge: EDGE * (1 << self.level) as f32,
                first: self.first,
                all: &mut *self.all,
                found: &mut *self.found,
                left: &mut left,
            });
        }
        left
    }
}

/// Returns among which neighbours are searched.
#[derive(Debug, Default)]
struct Candidates {
    index: Vec<u32>,
    /// Coordinates in groups; infinite after the last one.
    groups: Vec<[[f32; LANES]; 3]>,
    squares: Vec<[f32; LANES]>,
}

impl Candidates {
    /// Gathers every `step`th return of each of the `ranges`.
    fn gather(&mut self, points: &[[f32; 3]], ranges: &[std::ops::Range<u32>], step: usize) {
        self.index.clear();
        for range in ranges {
            if step == 1 {
                self.index.extend(range.clone());
            } else {
                self.index.extend(range.clone().step_by(step));
            }
        }
        self.groups.clear();
        for part in self.index.chunks(LANES) {
            let mut group = [[f32::INFINITY; LANES]; 3];
            for (l, &j) in part.iter().enumerate() {
                let [x, y, z] = points[j as usize];
                (group[0][l], group[1][l], group[2][l]) = (x, y, z);
            }
            self.groups.push(group);
        }
        self.squares.resize(self.groups.len(), [0.0; LANES]);
    }
}

/// A search for the neighbours of a group of returns among the same candidates.
struct Search<'a> {
    points: &'a [[f32; 3]],
    candidates: &'a mut Candidates,
    group: &'a [u32],
    /// The candidates have all returns within this distance, metres.
    edge: f32,
    first: usize,
    all: &'a mut [[u32; MOST]],
    found: &'a mut [Found],
    left: &'a mut Vec<u32>,
}

impl Kernel for Search<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { points, candidates: Candidates { index, groups, squares }, group, edge, first, all, found, left } = self;
        let most = edge * edge;
        // As if they were spread evenly over a plane through the middle.
        let mut limit = most * (LEAST as f32 * 9.0 / (std::f32::consts::PI * index.len() as f32));
        for &i in group {
            let p = points[i as usize];
            for (square, q) in squares.iter_mut().zip(&*groups) {
                for l in 0..LANES {
                    let [x, y, z] = [q[0][l] - p[0], q[1][l] - p[1], q[2][l] - p[2]];
                    square[l] = x * x + y * y + z * z;
                }
            }
            if !search_limit(squares, most, &mut limit) {
                left.push(i);
                continue;
            }
            let (mut near, mut count, mut reach) = ([0; MOST], 0, [0.0f32; LANES]);
            for (square, index) in squares.iter().zip(index.chunks(LANES)) {
                let mut bits = 0u32;
                for l in 0..LANES {
                    let is_near = square[l] <= limit;
                    bits |= u32::from(is_near) << l;
                    reach[l] = if is_near & (square[l] > reach[l]) { square[l] } else { reach[l] };
                }
                // More than there is room for only where some are equally far.
                while bits != 0 && count < MOST {
                    near[count] = index[bits.trailing_zeros() as usize];
                    (bits, count) = (bits & (bits - 1), count + 1);
                }
            }
            let last = reach.iter().fold(0.0f32, |a, &b| if b > a { b } else { a });
            let at = i as usize - first;
            all[at] = near;
            found[at] = Found { count: count as u32, reach: last.sqrt() };
        }
    }
}

/// Finds a limit below which [`LEAST`] to [`MOST`] of the `squares` are, from the one that is there; more only where some are equal. False if it is beyond `most`.
#[inline(always)]
fn search_limit(squares: &[[f32; LANES]], most: f32, limit: &mut f32) -> bool {
    /// Enough to tell one float from the next where the first guesses fail.
    const STEPS: usize = 40;
    let (mut low, mut high) = (0.0, f32::INFINITY);
    *limit = limit.min(most);
    for _ in 0..STEPS {
        let mut counts = [0u32; LANES];
        for square in squares {
            for l in 0..LANES {
                counts[l] += u32::from(square[l] <= *limit);
            }
        }
        let count = counts.iter().sum::<u32>();
        if count < LEAST as u32 {
            if *limit >= most {
                return false;
            }
            low = *limit;
        } else if count > MOST as u32 {
            high = *limit;
        } else {
            return true;
        }
        // On a plane, the count grows with the square of the distance.
        let guess = *limit * (0.5 * (LEAST + MOST) as f32 / count.max(1) as f32);
        let middle = if high < f32::INFINITY { 0.5 * (low + high) } else { 4.0 * low };
        *limit = if guess > low && guess < high { guess } else { middle }.min(most);
    }
    *limit = if high < f32::INFINITY { high } else { *limit };
    true
}

/// The neighbours of points, and the points in the order of their cells.
#[cfg(test)]
pub(super) fn found(points: &[[f32; 3]]) -> (Neighbours, Vec<[f32; 3]>) {
    let (mut order, mut which, mut neighbours) = (super::cells::CellOrder::default(), (0..points.len() as u32).collect(), Neighbours::default());
    order.sort(points, &mut which);
    let sorted: Vec<[f32; 3]> = which.iter().map(|&i| points[i as usize]).collect();
    neighbours.find(&sorted, &order.keys);
    (neighbours, sorted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(p: &[f32; 3], q: &[f32; 3]) -> f32 {
        let [x, y, z] = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
        x * x + y * y + z * z
    }

    proptest! {
        #[test]
        fn they_are_those_of_a_search_through_all(
            points in prop::collection::vec(prop::array::uniform3(-1f32..1.0), 1..400),
            size in 0.1f32..12.0,
            flatness in prop::sample::select(vec![0.0f32, 0.01, 1.0]),
        ) {
            let points: Vec<[f32; 3]> = points.iter().map(|p| [size * p[0], size * p[1], size * flatness * p[2]]).collect();
            let (neighbours, sorted) = found(&points);
            for (i, p) in sorted.iter().enumerate() {
                let of = neighbours.of(i);
                let mut all: Vec<f32> = sorted.iter().map(|q| square(p, q)).collect();
                all.sort_by(f32::total_cmp);
                if of.is_empty() {
                    // Alone: the twelfth other one is farther away than the largest cell is wide.
                    let edge = EDGE * (1 << (LEVELS - 1)) as f32;
                    prop_assert!(all.get(LEAST - 1).is_none_or(|&far| far > 0.999 * edge * edge), "{i}");
                    continue;
                }
                prop_assert!((LEAST..=MOST).contains(&of.len()) && of.contains(&(i as u32)));
                let mut found: Vec<f32> = of.iter().map(|&j| square(p, &sorted[j as usize])).collect();
                found.sort_by(f32::total_cmp);
                prop_assert_eq!(&found[..], &all[..of.len()]);
                prop_assert!((neighbours.spacing(i).powi(2) - all[of.len() - 1] * std::f32::consts::PI / of.len() as f32).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn coinciding_and_very_dense_returns_have_neighbours_too() {
        let mut points = vec![[1.0, 2.0, 3.0]; 3000];
        points.extend((0..500).map(|i| [1.0 + 1e-4 * i as f32, 2.5, 3.0]));
        let (neighbours, _) = found(&points);
        for i in 0..points.len() {
            assert!((LEAST..=MOST).contains(&neighbours.of(i).len()), "{i}");
        }
    }
}
