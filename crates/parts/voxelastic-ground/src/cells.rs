//! Grids of square cells of the map frame, aligned to the cells' edge.

/// Cells `[i, j]` from `low`, of which each covers `[i, i + 1) x [j, j + 1)` edges of the map frame: where a cell lies does not depend on how far the grid reaches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cells {
    /// Edge of a cell, metres.
    pub edge: f64,
    /// The cell with the smallest coordinates.
    pub low: [i32; 2],
    /// Cells along x and y.
    pub size: [usize; 2],
}

impl Cells {
    /// Number of cells.
    pub fn count(&self) -> usize {
        self.size[0] * self.size[1]
    }

    /// Smallest corner, metres.
    pub fn origin(&self) -> [f64; 2] {
        self.low.map(|c| f64::from(c) * self.edge)
    }

    /// Index of a cell, x fastest; none outside of the grid.
    pub fn index(&self, cell: [i32; 2]) -> Option<usize> {
        let [x, y] = [0, 1].map(|k| i64::from(cell[k]) - i64::from(self.low[k]));
        let is_inside = x >= 0 && y >= 0 && x < self.size[0] as i64 && y < self.size[1] as i64;
        is_inside.then(|| x as usize + self.size[0] * y as usize)
    }

    /// The cell at a point of the map frame, metres; none outside of the grid.
    pub fn at(&self, p: [f64; 2]) -> Option<usize> {
        let cell = p.map(|c| (c / self.edge).floor());
        // Beyond that the conversion saturates, and there is no grid.
        cell.iter().all(|c| c.abs() < f64::from(i32::MAX)).then(|| self.index(cell.map(|c| c as i32))).flatten()
    }

    /// Centre of a cell, metres.
    pub fn centre(&self, index: usize) -> [f64; 2] {
        let cell = [index % self.size[0], index / self.size[0]];
        [0, 1].map(|k| (f64::from(self.low[k]) + cell[k] as f64 + 0.5) * self.edge)
    }

    /// The cell `by` cells from another; none outside of the grid.
    #[inline]
    pub fn beside(&self, index: usize, by: [i32; 2]) -> Option<usize> {
        let x = (index % self.size[0]) as i64 + i64::from(by[0]);
        let y = (index / self.size[0]) as i64 + i64::from(by[1]);
        (x >= 0 && y >= 0 && x < self.size[0] as i64 && y < self.size[1] as i64).then(|| x as usize + self.size[0] * y as usize)
    }

    /// Cells that cover a length, at least one.
    pub fn reach(&self, metres: f64) -> i32 {
        ((metres / self.edge).round() as i32).max(1)
    }
}

/// Offsets to the eight cells around one.
pub(crate) const AROUND: [[i32; 2]; 8] = [[1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]];
