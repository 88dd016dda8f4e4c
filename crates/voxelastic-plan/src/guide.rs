//! Which way round? A lattice of places, looked at where a search goes, answers that sooner than trees that grow at random.
//!
//! The lattice is coarse, and a doorway may lie between its places. So a place where only a smaller ball fits is open as well, but tight: a step
//! there costs more. A way over the lattice is no path yet. [`Guide::path`] goes along it in whole motions, lets two small trees (`connect.rs`)
//! look for the way through where it is tight, and where there is none shuts the place and looks for another way round.

use crate::budget::Budget;
use crate::connect::connect;
use crate::points::{Point, distance};
use crate::sample::Sampler;
use crate::space::{Fit, Space};
use crate::tree::Tree;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Distance of the places against the robot's radius, on wheels and in the air, and its limits, metres.
const EDGE: [f64; 2] = [0.7, 1.0];
const EDGES: [f64; 2] = [0.15, 0.5];
/// The smaller ball's radius lacks this share of the distance of the places: no lattice misses a gap that the robot fits through.
const LESS: f64 = 0.5;
/// What a step to a tight place costs against one to another.
const TIGHT: f32 = 4.0;
/// Most places of a lattice; where there would be more they are farther apart.
const MOST: f64 = 3e7;
/// Height of a storey, metres: on wheels, places above each other are that far apart.
const STOREY: f64 = 1.5;
/// So many places whose neighbours were looked at count as a sample.
const PLACES_A_SAMPLE: usize = 32;
/// Longest motion that is tried along a way, places.
const LONGEST: usize = 64;
/// Samples for the way through a tight place, how long the trees' branches are, and how much longer than straight it may be, metres.
const THROUGH: usize = 120;
const BRANCH: f64 = 1.0;
const DETOUR: f64 = 2.0;
/// How many places beyond a tight one are tried, and how many lie between two that are.
const TRIES: usize = 3;
const APART: usize = 4;

/// A doorway's middle is looked for in steps of this share of the distance of the places, and so many of them to either side.
const ASIDE: f64 = 1.0 / 32.0;
const MOST_ASIDE: i32 = 28;
/// In the air, places are looked at in cubes of this many first: most of space is open.
const CUBE: usize = 4;

/// Sums of the same lengths in another order differ by less, metres.
const LEAST_GAIN: f32 = 1e-2;

/// What a search is to look for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wish {
    /// How much the way that is left counts against that behind: 1 for the shortest, more for any one sooner.
    pub greed: f32,
    /// No way that would be longer than this even if it were straight from any place to the goal, metres.
    pub longest: f64,
}

/// A lattice for ways between two places. It keeps what it has seen for the next search.
pub(crate) struct Guide<'a, S> {
    space: &'a S,
    ends: [Point; 2],
    /// Distance of the places along each axis, where the first is, and how many there are.
    apart: Point,
    low: Point,
    size: [usize; 3],
    seen: Vec<Option<Fit>>,
    /// Whether a cube of places was looked at as a whole.
    cubes: Vec<bool>,
    /// Heights of the places that wheels were at.
    heights: Vec<f32>,
}

/// A place to go on from: the estimated length of the way over it, the place, and the length to there at that time.
type Open = (Reverse<u32>, u32, u32);

impl<'a, S: Space> Guide<'a, S> {
    /// A lattice that the first of `ends` is a place of, for a robot of this radius.
    pub(crate) fn new(space: &'a S, ends: [Point; 2], radius: f64) -> Self {
        let ([low, high], start) = (space.bounds(), ends[0]);
        let is_flat = space.dimensions() == 2;
        let mut edge = (EDGE[usize::from(!is_flat)] * radius).clamp(EDGES[0], EDGES[1]);
        let lattice = |edge: f64| {
            let apart = [edge, edge, if is_flat { STOREY } else { edge }];
            let before: Point = std::array::from_fn(|k| ((start[k] - low[k]) / apart[k]).floor().max(0.0));
            let count: Point = std::array::from_fn(|k| before[k] + ((high[k] - start[k]) / apart[k]).floor().max(0.0) + 1.0);
            (apart, std::array::from_fn(|k| start[k] - before[k] * apart[k]), count)
        };
        while lattice(edge).2.iter().product::<f64>() > MOST && edge < 1e9 {
            edge *= 1.2;
        }
        let (apart, low, count) = lattice(edge);
        // Without end, or no numbers: no lattice.
        let is_small = count.iter().product::<f64>() <= MOST;
        let size = count.map(|c| if is_small { c as usize } else { 0 });
        let all = size.iter().product();
        let cubes = if is_flat { 0 } else { size.map(|count: usize| count.div_ceil(CUBE)).iter().product() };
        let heights = if is_flat { vec![0.0; all] } else { Vec::new() };
        Self { space, ends, apart, low, size, seen: vec![None; all], cubes: vec![false; cubes], heights }
    }

    /// A path, every motion of which is free; none when there is none as wished, or the budget ends before.
    pub(crate) fn path(&mut self, sampler: &mut Sampler<'_, S>, wish: Wish, budget: &Budget) -> Option<Vec<Point>> {
        loop {
            let way = self.search(sampler, wish, budget)?;
            match self.go(sampler, &way, budget) {
                Ok(path) => return Some(path),
                Err(shut) => shut.iter().for_each(|place| self.seen[*place] = Some(Fit::Not)),
            }
            if way.len() == 1 || budget.is_spent(sampler.drawn) {
                return None;
            }
        }
    }

    fn place_at(&self, p: Point) -> Option<usize> {
        let c: Point = std::array::from_fn(|k| ((p[k] - self.low[k]) / self.apart[k]).round());
        let is_inside = (0..3).all(|k| c[k] >= 0.0 && c[k] < self.size[k] as f64);
        is_inside.then(|| c[0] as usize + self.size[0] * (c[1] as usize + self.size[1] * c[2] as usize))
    }

    fn coords(&self, place: usize) -> [usize; 3] {
        [place % self.size[0], place / self.size[0] % self.size[1], place / (self.size[0] * self.size[1])]
    }

    fn at(&self, c: [usize; 3]) -> Point {
        std::array::from_fn(|k| self.low[k] + c[k] as f64 * self.apart[k])
    }

    fn point(&self, place: usize) -> Point {
        let p = self.at(self.coords(place));
        self.heights.get(place).map_or(p, |z| [p[0], p[1], f64::from(*z)])
    }

    /// Looks at the cube around a place, unless it was looked at before; whether the robot fits in all of it.
    fn is_cube_open(&mut self, place: usize) -> bool {
        let cube = self.coords(place).map(|c| c / CUBE);
        let count = self.size.map(|count| count.div_ceil(CUBE));
        let is_new = self.cubes.get_mut(cube[0] + count[0] * (cube[1] + count[1] * cube[2])).is_some_and(|cube| !std::mem::replace(cube, true));
        let first = cube.map(|c| c * CUBE);
        let last: [usize; 3] = std::array::from_fn(|k| (first[k] + CUBE).min(self.size[k]) - 1);
        if !is_new || !self.space.is_open([self.at(first), self.at(last)]) {
            return false;
        }
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                let row = self.size[0] * (y + self.size[1] * z);
                self.seen[row + first[0]..=row + last[0]].fill(Some(Fit::Whole));
            }
        }
        true
    }

    /// The place beside another, which is at `from`, and how the robot fits there; none where it does not.
    fn beside(&mut self, c: [usize; 3], from: Point, by: [i8; 3]) -> Option<(usize, Fit)> {
        let place = if self.heights.is_empty() {
            let next: [usize; 3] = std::array::from_fn(|k| c[k].wrapping_add_signed(isize::from(by[k])));
            let place = next[0].wrapping_add(self.size[0].wrapping_mul(next[1].wrapping_add(self.size[1].wrapping_mul(next[2]))));
            let is_inside = (0..3).all(|k| next[k] < self.size[k]);
            let is_new = is_inside && self.seen[place].is_none() && !self.is_cube_open(place);
            if is_new {
                self.seen[place] = Some(self.space.fit(self.at(next), LESS * self.apart[0]));
            }
            Some(place).filter(|_| is_inside)
        } else {
            let to = self.space.alongside(from, std::array::from_fn(|k| from[k] + f64::from(by[k]) * self.apart[k]))?;
            let place = self.place_at(to)?;
            if self.seen[place].is_none() {
                self.seen[place] = Some(self.space.fit(to, LESS * self.apart[0]));
                self.heights[place] = to[2] as f32;
            }
            Some(place)
        }?;
        self.seen[place].filter(|fit| *fit != Fit::Not).map(|fit| (place, fit))
    }

    /// Length of the shortest way to the goal over an empty lattice, and straight, metres.
    fn left(&self, p: Point) -> (f32, f64) {
        let count = if self.heights.is_empty() { 3 } else { 2 };
        let mut off: Point = std::array::from_fn(|k| if k < count { (p[k] - self.ends[1][k]).abs() } else { 0.0 });
        let straight = off.iter().map(|c| c * c).sum::<f64>().sqrt();
        off.sort_unstable_by(f64::total_cmp);
        let [least, middle, most] = off;
        ((least * (3f64.sqrt() - 2f64.sqrt()) + middle * (2f64.sqrt() - 1.0) + most) as f32, straight)
    }

    fn is_at_goal(&self, p: Point) -> bool {
        (0..3).all(|k| (p[k] - self.ends[1][k]).abs() <= 0.51 * self.apart[k])
    }

    /// The places of a way over the lattice, the shortest by what steps cost if not greedy.
    fn search(&mut self, sampler: &mut Sampler<'_, S>, wish: Wish, budget: &Budget) -> Option<Vec<usize>> {
        let first = self.place_at(self.ends[0])?;
        if let Some(height) = self.heights.get_mut(first) {
            *height = self.ends[0][2] as f32;
        }
        let steps = self.steps();
        // Memory that is never written to costs nothing: 0 is what was not reached.
        let (mut costs, mut before) = (vec![0f32; self.seen.len()], vec![0u32; self.seen.len()]);
        costs[first] = f32::MIN_POSITIVE;
        let mut open: BinaryHeap<Open> = BinaryHeap::from([(Reverse(0), first as u32, costs[first].to_bits())]);
        let mut looked = 0;
        while let Some((_, place, then)) = open.pop() {
            let (at, cost) = (place as usize, costs[place as usize]);
            if cost.to_bits() != then {
                continue;
            }
            let p = self.point(at);
            if self.is_at_goal(p) {
                let mut way: Vec<usize> = std::iter::successors(Some(at), |at| (*at != first).then(|| before[*at] as usize)).collect();
                way.reverse();
                return Some(way);
            }
            looked += 1;
            if looked == PLACES_A_SAMPLE {
                looked = 0;
                sampler.drawn += 1;
                if budget.is_spent(sampler.drawn) {
                    return None;
                }
            }
            let c = self.coords(at);
            for &(by, length) in &steps {
                let Some((to, fit)) = self.beside(c, p, by) else { continue };
                let reached = cost + if fit == Fit::Whole { length } else { TIGHT * length };
                // In a hurry the first way to a place will do.
                if costs[to] != 0.0 && (costs[to] <= reached + LEAST_GAIN || wish.greed > 1.0) {
                    continue;
                }
                let (left, straight) = self.left(self.point(to));
                if distance(self.point(to), self.ends[0]).max(0.9 * f64::from(reached)) + straight > wish.longest {
                    continue;
                }
                (costs[to], before[to]) = (reached, place);
                // What is not negative is in the same order as its bits.
                open.push((Reverse((reached + wish.greed * left).to_bits()), to as u32, reached.to_bits()));
            }
        }
        None
    }

    /// The steps to the places beside one, and their lengths.
    fn steps(&self) -> Vec<([i8; 3], f32)> {
        let is_flat = !self.heights.is_empty();
        let all = (0..27i8).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]).filter(|by| *by != [0; 3] && !(is_flat && by[2] != 0));
        all.map(|by| (by, (self.apart[0] * f64::from(by.iter().map(|c| c * c).sum::<i8>()).sqrt()) as f32)).collect()
    }

    /// A path along a way.
    ///
    /// # Errors
    /// The places where it is too tight.
    fn go(&mut self, sampler: &mut Sampler<'_, S>, way: &[usize], budget: &Budget) -> Result<Vec<Point>, Vec<usize>> {
        let mut path = vec![self.ends[0]];
        // How many places of the way are behind.
        let mut behind = 1;
        while behind <= way.len() {
            let at = path[path.len() - 1];
            if let Some((past, arrived)) = self.ahead(at, way, behind) {
                path.push(arrived);
                behind = past;
                continue;
            }
            let tried = self.beyond(way, behind);
            let through = tried.iter().find_map(|&next| {
                let middles = self.middles(way, behind, next);
                Some((next, self.through(sampler, [at, self.aim(way, next)], &middles, budget)?))
            });
            let Some((next, piece)) = through else {
                let first = behind.min(way.len() - 1);
                return Err(way[first..tried[0].clamp(first + 1, way.len())].to_vec());
            };
            way[behind..=next.min(way.len() - 1)].iter().for_each(|place| self.seen[*place] = Some(Fit::Whole));
            path.extend(&piece[1..]);
            behind = next + 1;
        }
        Ok(path)
    }

    /// A place of the way; behind its last is the goal.
    fn aim(&self, way: &[usize], i: usize) -> Point {
        way.get(i).map_or(self.ends[1], |place| self.point(*place))
    }

    /// The farthest place of the way that doubling steps find a motion to: how many are behind then, and where the robot arrives.
    fn ahead(&self, at: Point, way: &[usize], behind: usize) -> Option<(usize, Point)> {
        let mut found = None;
        let mut step = 1;
        while step <= LONGEST {
            let next = (behind + step - 1).min(way.len());
            let aim = self.aim(way, next);
            let is_goal = next == way.len();
            let arrived = self.space.reach(at, aim).filter(|arrived| !is_goal || self.space.is_same(*arrived, aim));
            let Some(arrived) = arrived else { return found };
            found = Some((next + 1, if is_goal { aim } else { arrived }));
            if is_goal {
                return found;
            }
            step *= 2;
        }
        found
    }

    /// Places from `behind` on that are not tight, to look for a way to; the goal at last.
    fn beyond(&self, way: &[usize], behind: usize) -> Vec<usize> {
        let is_wide = |i: &usize| way.get(*i).is_none_or(|place| self.seen[*place] == Some(Fit::Whole));
        let mut tried: Vec<usize> = Vec::new();
        for i in (behind..=way.len()).filter(is_wide) {
            if tried.last().is_none_or(|last| i > last + APART) && tried.len() < TRIES {
                tried.push(i);
            }
        }
        tried
    }

    /// For each tight place before `end` the middle of where the robot fits beside it, across the way: where a doorway's middle is.
    fn middles(&self, way: &[usize], behind: usize, end: usize) -> Vec<Point> {
        let tight = (behind..end.min(way.len())).filter(|i| self.seen[way[*i]] == Some(Fit::Nearly));
        let middle = |i: usize| {
            let (before, after) = (self.aim(way, i.saturating_sub(2)), self.aim(way, (i + 2).min(way.len())));
            let (x, y) = (after[0] - before[0], after[1] - before[1]);
            let across = if x.hypot(y) > 0.0 { [-y / x.hypot(y), x / x.hypot(y)] } else { [1.0, 0.0] };
            let p = self.point(way[i]);
            let rises: &[f64] = if self.heights.is_empty() { &[0.0, 0.5, -0.5] } else { &[0.0] };
            rises.iter().find_map(|rise| {
                let aside = |k: i32| {
                    let by = f64::from(k) * ASIDE * self.apart[0];
                    self.space.settle([p[0] + by * across[0], p[1] + by * across[1], p[2] + rise * self.apart[2]])
                };
                let free: Vec<Option<Point>> = (-MOST_ASIDE..=MOST_ASIDE).map(aside).collect();
                let widest = free.split(|p| p.is_none()).max_by_key(|run| run.len())?;
                *widest.get(widest.len() / 2)?
            })
        };
        tight.filter_map(middle).collect()
    }

    /// A path from one place to another near by: over some places, if they can be reached one from the other.
    fn through(&self, sampler: &mut Sampler<'_, S>, [from, to]: [Point; 2], over: &[Point], budget: &Budget) -> Option<Vec<Point>> {
        let to = if to == self.ends[1] { to } else { self.space.settle(to)? };
        let direct = over.iter().try_fold(vec![from], |mut path, p| {
            path.push(self.space.reach(path[path.len() - 1], *p)?);
            Some(path)
        });
        if let Some(mut path) = direct.filter(|path| self.space.joins(path[path.len() - 1], to)) {
            path.push(to);
            return Some(path);
        }
        let mut local = sampler.child();
        local.keep_within([from, to], distance(from, to) + DETOUR);
        let mut trees = [from, to].map(|end| Tree::new(end, self.space.dimensions()));
        let met = connect(&mut local, self.space, &mut trees, BRANCH, over, &budget.samples(THROUGH));
        sampler.drawn += local.drawn;
        let [mut tree, other] = trees;
        let met = met?;
        let end = tree.graft(met.from_start, &other, met.from_goal)[0];
        Some(tree.way_to(end))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::{between, length};
    use std::time::Duration;

    const RADIUS: f64 = 0.35;

    /// A plane with a thin wall along x = 0 that has gaps: middle and width.
    struct Wall(Vec<[f64; 2]>);

    impl Wall {
        fn clearance(&self, p: Point) -> f64 {
            let nearest = |gap: &[f64; 2]| {
                let inside = 0.5 * gap[1] - (p[1] - gap[0]).abs();
                if inside > 0.0 { p[0].hypot(inside) } else { p[0].abs() }
            };
            self.0.iter().map(nearest).fold(p[0].abs(), f64::max)
        }
    }

    impl Space for Wall {
        fn reach(&self, from: Point, to: Point) -> Option<Point> {
            let count = (distance(from, to) / 0.02).ceil().max(1.0) as usize;
            (0..=count).all(|i| self.settle(between(from, to, i as f64 / count as f64)).is_some()).then_some(to)
        }

        fn settle(&self, p: Point) -> Option<Point> {
            (p[0].abs() <= 10.0 && p[1].abs() <= 10.0 && self.clearance(p) >= RADIUS).then_some(p)
        }

        fn fit(&self, p: Point, less: f64) -> Fit {
            let clearance = self.clearance(p);
            if clearance >= RADIUS {
                Fit::Whole
            } else if clearance >= RADIUS - less {
                Fit::Nearly
            } else {
                Fit::Not
            }
        }

        fn bounds(&self) -> [Point; 2] {
            [[-10.0, -10.0, 0.0], [10.0, 10.0, 0.01]]
        }
    }

    const ENDS: [Point; 2] = [[-5.0, -8.03, 0.0], [5.0, -8.0, 0.0]];

    fn search(gaps: &[[f64; 2]], wish: Wish) -> (Option<Vec<Point>>, usize) {
        let wall = Wall(gaps.to_vec());
        let mut sampler = Sampler::new(&wall, 3);
        let budget = Budget::new(Duration::from_secs(60), Some(20_000));
        let path = Guide::new(&wall, ENDS, RADIUS).path(&mut sampler, wish, &budget);
        if let Some(path) = &path {
            assert_eq!((path[0], path[path.len() - 1]), (ENDS[0], ENDS[1]));
            assert!(path.windows(2).all(|w| wall.joins(w[0], w[1])));
        }
        (path, sampler.drawn)
    }

    const SHORTEST: Wish = Wish { greed: 1.0, longest: f64::INFINITY };

    #[test]
    fn a_gap_is_found_that_lies_between_the_places_of_the_lattice() {
        // The robot's centre has 2 cm.
        for middle in [6.0, 6.03, 6.08, 6.12, 6.17, 6.21] {
            let (path, _) = search(&[[middle, 2.0 * RADIUS + 0.02]], SHORTEST);
            let path = path.expect("there is a gap");
            assert!(path.iter().any(|p| p[1] > middle - 0.5));
            assert!(length(&path) < 1.2 * 2.0 * 14f64.hypot(5.0), "{}", length(&path));
        }
    }

    #[test]
    fn what_is_too_narrow_is_shut_and_gone_around() {
        let (narrow, wide) = ([-7.0, 2.0 * RADIUS - 0.03], [8.0, 1.2]);
        let (path, _) = search(&[narrow, wide], SHORTEST);
        assert!(path.expect("there is a gap").iter().any(|p| p[1] > 7.5));
        // Of two gaps the nearer, unless in a hurry; then any.
        let (path, _) = search(&[[-2.0, 1.0], wide], SHORTEST);
        assert!(path.expect("there are gaps").iter().all(|p| p[1] < 0.0));
        assert!(search(&[[-2.0, 1.0], wide], Wish { greed: 3.0, ..SHORTEST }).0.is_some());
    }

    #[test]
    fn a_search_ends_when_there_is_no_way_as_wished() {
        let (path, drawn) = search(&[], SHORTEST);
        assert!(path.is_none() && drawn < 1000, "{drawn}");
        let (path, drawn) = search(&[[6.0, 1.0]], Wish { longest: 20.0, ..SHORTEST });
        assert!(path.is_none() && drawn < 1000, "{drawn}");
        let (path, drawn) = search(&[[-7.0, 2.0 * RADIUS - 0.03]], SHORTEST);
        assert!(path.is_none() && drawn < 3000, "{drawn}");
    }
}
