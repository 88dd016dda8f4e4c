//! Floor plans: rectangular areas of free space in rock, and the walls around them.

/// A rectangle of free space with its own ceiling, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Area {
    pub low: [f64; 2],
    pub high: [f64; 2],
    pub ceiling: f64,
    /// How far rock may protrude from the walls around it, metres.
    pub roughness: f64,
}

/// A straight wall between rock and an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wall {
    /// Ends, metres.
    pub from: [f64; 2],
    pub to: [f64; 2],
    /// Unit vector from the rock into the area.
    pub inwards: [f64; 2],
    pub ceiling: f64,
    pub roughness: f64,
}

/// Areas on the grid of all their edges: every cell is either free or rock.
pub(super) struct FloorPlan<'a> {
    areas: &'a [Area],
    x: Vec<f64>,
    y: Vec<f64>,
}

impl<'a> FloorPlan<'a> {
    /// The plan of `areas` in a block of rock that extends `margin` metres beyond them.
    pub(super) fn new(areas: &'a [Area], margin: f64) -> Self {
        let edges = |k: usize| {
            let mut all: Vec<f64> = areas.iter().flat_map(|a| [a.low[k], a.high[k]]).collect();
            all.sort_by(f64::total_cmp);
            all.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
            if let (Some(&first), Some(&last)) = (all.first(), all.last()) {
                all.insert(0, first - margin);
                all.push(last + margin);
            }
            all
        };
        Self { areas, x: edges(0), y: edges(1) }
    }

    fn columns(&self) -> usize {
        self.x.len().saturating_sub(1)
    }

    fn rows(&self) -> usize {
        self.y.len().saturating_sub(1)
    }

    /// The area that a cell belongs to; none for rock.
    fn area(&self, column: usize, row: usize) -> Option<&'a Area> {
        let (x, y) = ((self.x[column] + self.x[column + 1]) / 2.0, (self.y[row] + self.y[row + 1]) / 2.0);
        self.areas.iter().find(|a| x > a.low[0] && x < a.high[0] && y > a.low[1] && y < a.high[1])
    }

    /// The rock as rectangles that touch but do not overlap: runs along x, merged over rows where they are equal.
    pub(super) fn rock(&self) -> Vec<([f64; 2], [f64; 2])> {
        let mut done: Vec<([f64; 2], [f64; 2])> = Vec::new();
        let mut growing: Vec<([f64; 2], [f64; 2])> = Vec::new();
        for row in 0..self.rows() {
            let mut runs: Vec<([f64; 2], [f64; 2])> = Vec::new();
            let mut column = 0;
            while column < self.columns() {
                let start = column;
                while column < self.columns() && self.area(column, row).is_none() {
                    column += 1;
                }
                if column > start {
                    runs.push(([self.x[start], self.y[row]], [self.x[column], self.y[row + 1]]));
                }
                column += 1;
            }
            for run in &mut runs {
                if let Some(at) = growing.iter().position(|o| o.0[0] == run.0[0] && o.1[0] == run.1[0]) {
                    run.0[1] = growing.swap_remove(at).0[1];
                }
            }
            done.append(&mut growing);
            growing = runs;
        }
        done.append(&mut growing);
        done
    }

    /// All walls; each is straight and belongs to one area.
    pub(super) fn walls(&self) -> Vec<Wall> {
        let mut walls = Vec::new();
        for row in 0..self.rows() {
            for (side, line) in [(-1.0, row), (1.0, row + 1)] {
                let beyond =
                    |column: usize| if side < 0.0 { row.checked_sub(1) } else { Some(row + 1).filter(|&r| r < self.rows()) }.map(|r| (column, r));
                self.runs(
                    self.columns(),
                    |column| ((column, row), beyond(column)),
                    |start, end, area| {
                        let (from, to) = ([self.x[start], self.y[line]], [self.x[end], self.y[line]]);
                        walls.push(Wall { from, to, inwards: [0.0, -side], ceiling: area.ceiling, roughness: area.roughness });
                    },
                );
            }
        }
        for column in 0..self.columns() {
            for (side, line) in [(-1.0, column), (1.0, column + 1)] {
                let beyond =
                    |row: usize| if side < 0.0 { column.checked_sub(1) } else { Some(column + 1).filter(|&c| c < self.columns()) }.map(|c| (c, row));
                self.runs(
                    self.rows(),
                    |row| ((column, row), beyond(row)),
                    |start, end, area| {
                        let (from, to) = ([self.x[line], self.y[start]], [self.x[line], self.y[end]]);
                        walls.push(Wall { from, to, inwards: [-side, 0.0], ceiling: area.ceiling, roughness: area.roughness });
                    },
                );
            }
        }
        walls
    }

    /// Runs of cells of one area with rock beyond. `cells` returns the cell at an index and the one beyond it.
    fn runs(&self, count: usize, cells: impl Fn(usize) -> ((usize, usize), Option<(usize, usize)>), mut found: impl FnMut(usize, usize, &Area)) {
        let at = |k: usize| {
            let ((column, row), beyond) = cells(k);
            let is_rock = beyond.is_none_or(|(c, r)| self.area(c, r).is_none());
            self.area(column, row).filter(|_| is_rock)
        };
        let mut start = 0;
        while start < count {
            let Some(area) = at(start) else {
                start += 1;
                continue;
            };
            let end = (start + 1..count).find(|&k| at(k) != Some(area)).unwrap_or(count);
            found(start, end, area);
            start = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn rock_and_areas_partition_the_block_and_walls_bound_the_areas() {
        let mut random = Stream::new(3, &[]);
        for _ in 0..50 {
            let areas: Vec<Area> = (0..5)
                .map(|_| {
                    let low = [random.range(0.0, 20.0), random.range(0.0, 20.0)];
                    let high = [low[0] + random.range(1.0, 8.0), low[1] + random.range(1.0, 8.0)];
                    Area { low, high, ceiling: 3.0, roughness: 0.0 }
                })
                .collect();
            let plan = FloorPlan::new(&areas, 2.0);
            let rock = plan.rock();
            for _ in 0..200 {
                let p = [random.range(0.0, 26.0), random.range(0.0, 26.0)];
                let inside = |low: [f64; 2], high: [f64; 2]| p[0] > low[0] && p[0] < high[0] && p[1] > low[1] && p[1] < high[1];
                let free = areas.iter().any(|a| inside(a.low, a.high));
                let in_block = inside([plan.x[0], plan.y[0]], [plan.x[plan.columns()], plan.y[plan.rows()]]);
                assert_eq!(rock.iter().filter(|r| inside(r.0, r.1)).count(), usize::from(in_block && !free));
            }
            for wall in plan.walls() {
                let middle = [(wall.from[0] + wall.to[0]) / 2.0, (wall.from[1] + wall.to[1]) / 2.0];
                let near = |d: f64| [middle[0] + wall.inwards[0] * d, middle[1] + wall.inwards[1] * d];
                let free = |p: [f64; 2]| areas.iter().any(|a| p[0] > a.low[0] && p[0] < a.high[0] && p[1] > a.low[1] && p[1] < a.high[1]);
                assert!(free(near(1e-6)) && !free(near(-1e-6)));
            }
        }
    }
}
