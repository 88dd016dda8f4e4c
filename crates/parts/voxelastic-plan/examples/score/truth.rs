//! The true world as a configuration space with exact sweeps, and shortest paths in any space by A* on a fine grid.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use voxelastic_plan::{Point, Space, between, distance};
use voxelastic_sim::World;

/// A ball in the true world.
pub struct Truth<'a> {
    pub world: &'a World,
    pub radius: f64,
    pub bounds: [Point; 2],
}

impl Truth<'_> {
    /// Least distance to the world along a straight motion; stops at the first below `enough`. Steps are as long as the distance allows, at least a
    /// millimetre.
    pub fn least(&self, from: Point, to: Point, enough: f64) -> f64 {
        let all = distance(from, to);
        let (mut at, mut least) = (0.0, f64::INFINITY);
        loop {
            let d = self.world.distance(between(from, to, if all > 0.0 { (at / all).min(1.0) } else { 0.0 }));
            least = least.min(d);
            if least < enough || at >= all {
                return least;
            }
            at = (at + (d - enough).max(1e-3)).min(all);
        }
    }
}

impl Space for Truth<'_> {
    fn steer(&self, from: Point, to: Point) -> Option<Point> {
        let inside = (0..3).all(|k| to[k] >= self.bounds[0][k] && to[k] <= self.bounds[1][k]);
        (inside && self.least(from, to, self.radius) >= self.radius).then_some(to)
    }

    fn state_at(&self, p: Point) -> Option<Point> {
        (self.world.distance(p) >= self.radius).then_some(p)
    }

    fn bounds(&self) -> [Point; 2] {
        self.bounds
    }
}

/// A grid over a space; cells are evaluated on demand.
pub struct Grid<'a, S> {
    space: &'a S,
    /// On the ground, the height of all cells, metres.
    height: Option<f64>,
    edge: f64,
    size: [usize; 3],
    /// 0: not evaluated, 1: free, 2: blocked.
    cells: Vec<u8>,
    costs: Vec<f32>,
    from: Vec<u32>,
}

impl<'a, S: Space> Grid<'a, S> {
    pub fn new(space: &'a S, height: Option<f64>, edge: f64) -> Self {
        let [low, high] = space.bounds();
        let layers = |k: usize| if k == 2 && height.is_some() { 1 } else { ((high[k] - low[k]) / edge).floor() as usize + 1 };
        let size = [layers(0), layers(1), layers(2)];
        let count = size.iter().product();
        Self { space, height, edge, size, cells: vec![0; count], costs: Vec::new(), from: Vec::new() }
    }

    fn point(&self, c: [usize; 3]) -> Point {
        let low = self.space.bounds()[0];
        let p: Point = std::array::from_fn(|k| low[k] + c[k] as f64 * self.edge);
        self.height.map_or(p, |z| [p[0], p[1], z])
    }

    fn coords(&self, cell: usize) -> [usize; 3] {
        [cell % self.size[0], cell / self.size[0] % self.size[1], cell / (self.size[0] * self.size[1])]
    }

    fn cell(&self, c: [usize; 3]) -> usize {
        c[0] + self.size[0] * (c[1] + self.size[1] * c[2])
    }

    fn is_free(&mut self, cell: usize) -> bool {
        if self.cells[cell] == 0 {
            let free = self.space.state_at(self.point(self.coords(cell))).is_some();
            self.cells[cell] = if free { 1 } else { 2 };
        }
        self.cells[cell] == 1
    }

    /// The free cell nearest to `p` that a free motion leads to.
    fn entry_cell(&mut self, p: Point) -> Option<usize> {
        let low = self.space.bounds()[0];
        let middle: [i64; 3] = std::array::from_fn(|k| ((p[k] - low[k]) / self.edge).round() as i64);
        let mut best: Option<(f64, usize)> = None;
        for i in 0..343i64 {
            let c: [i64; 3] = [middle[0] + i % 7 - 3, middle[1] + i / 7 % 7 - 3, if self.size[2] == 1 { 0 } else { middle[2] + i / 49 - 3 }];
            if (0..3).any(|k| c[k] < 0 || c[k] >= self.size[k] as i64) {
                continue;
            }
            let cell = self.cell(c.map(|v| v as usize));
            let off = distance(self.point(self.coords(cell)), p);
            if best.is_none_or(|b| off < b.0) && self.is_free(cell) && self.space.steer(p, self.point(self.coords(cell))).is_some() {
                best = Some((off, cell));
            }
        }
        best.map(|b| b.1)
    }

    /// The shortest path over free cells and their 26 (on the ground 8) neighbours; none when there is none.
    pub fn search(&mut self, start: Point, goal: Point) -> Option<Vec<Point>> {
        let (first, last) = (self.entry_cell(start)?, self.entry_cell(goal)?);
        let target = self.point(self.coords(last));
        self.costs.clear();
        self.costs.resize(self.cells.len(), f32::INFINITY);
        self.from.resize(self.cells.len(), u32::MAX);
        self.costs[first] = 0.0;
        self.from[first] = u32::MAX;
        let mut queue = BinaryHeap::from([Reverse((0u64, first as u32))]);
        while let Some(Reverse((_, cell))) = queue.pop() {
            let at = cell as usize;
            if at == last {
                let mut path = vec![goal];
                let mut next = cell;
                while next != u32::MAX {
                    path.push(self.point(self.coords(next as usize)));
                    next = self.from[next as usize];
                }
                path.push(start);
                path.reverse();
                return Some(path);
            }
            let c = self.coords(at);
            for i in 0..27 {
                let by = [i % 3, i / 3 % 3, i / 9];
                let next: [usize; 3] = std::array::from_fn(|k| (c[k] + by[k]).wrapping_sub(1));
                if i == 13 || (0..3).any(|k| next[k] >= self.size[k]) {
                    continue;
                }
                let to = self.cell(next);
                let moves = by.iter().filter(|b| **b != 1).count() as f64;
                let cost = self.costs[at] + (moves.sqrt() * self.edge) as f32;
                if cost < self.costs[to] - 1e-4 && self.is_free(to) {
                    self.costs[to] = cost;
                    self.from[to] = cell;
                    let ahead = distance(self.point(next), target);
                    queue.push(Reverse((((f64::from(cost) + ahead) * 1e4) as u64, to as u32)));
                }
            }
        }
        None
    }
}
