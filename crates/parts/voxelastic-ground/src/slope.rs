//! Slope and roughness: the plane through the floor around a cell.

use crate::cells::Cells;
use crate::floor_cell::{FloorCell, Known};

/// The plane is fitted to the floor this far around, metres.
const AROUND: f64 = 0.25;
/// Least number of cells of a plane.
const LEAST_CELLS: f64 = 6.0;
/// The heights around a step are off its plane by a sixth of the plane's rise, those of a slope by much less.
const EVEN: f64 = 0.1;

/// A plane through the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Its rise along x and y.
    pub gradient: [f64; 2],
    /// Its height at the cell, metres.
    pub height: f64,
    /// Mean deviation of heights from it (root mean square), metres: how rough the floor is.
    pub roughness: f64,
}

impl Plane {
    /// The plane through the floor around a cell; none where too little of it was seen.
    pub fn around(cells: &Cells, floor: &[FloorCell], cell: usize) -> Option<Self> {
        let reach = cells.reach(AROUND);
        let origin = f64::from(floor[cell].height);
        let (mut n, mut s, mut ss) = (0.0, [0.0f64; 3], [0.0f64; 6]);
        for y in -reach..=reach {
            for x in -reach..=reach {
                let Some(other) = cells.beside(cell, [x, y]).map(|at| &floor[at]).filter(|o| o.known == Known::Seen) else { continue };
                let (x, y, z) = (f64::from(x) * cells.edge, f64::from(y) * cells.edge, f64::from(other.height) - origin);
                n += 1.0;
                s = [s[0] + x, s[1] + y, s[2] + z];
                ss = [ss[0] + x * x, ss[1] + y * y, ss[2] + z * z, ss[3] + x * y, ss[4] + x * z, ss[5] + y * z];
            }
        }
        if n < LEAST_CELLS {
            return None;
        }
        let mean = s.map(|c| c / n);
        let [xx, yy, zz] = [0, 1, 2].map(|k| ss[k] - n * mean[k] * mean[k]);
        let [xy, xz, yz] = [(3, 0, 1), (4, 0, 2), (5, 1, 2)].map(|(k, a, b)| ss[k] - n * mean[a] * mean[b]);
        let determinant = xx * yy - xy * xy;
        // In a row of cells there is no plane.
        if determinant <= 1e-3 * xx * yy || xx * yy == 0.0 {
            return None;
        }
        let gradient = [(yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant];
        let left = (zz - gradient[0] * xz - gradient[1] * yz).max(0.0);
        let height = origin + mean[2] - gradient[0] * mean[0] - gradient[1] * mean[1];
        Some(Self { gradient, height, roughness: (left / n).sqrt() })
    }

    /// Its slope, radians.
    pub fn slope(&self) -> f64 {
        self.gradient[0].hypot(self.gradient[1]).atan()
    }
}

/// The slope of the floor around a cell, radians, if it is even. Steps are judged by their heights.
pub(crate) fn even_slope(cells: &Cells, floor: &[FloorCell], cell: usize) -> Option<f64> {
    let plane = Plane::around(cells, floor, cell)?;
    let rise = 2.0 * AROUND * plane.slope().tan();
    (plane.roughness <= EVEN * rise).then_some(plane.slope())
}
