//! Draws turned boxes into a tile of cells, exactly: a cell is set when box and cell overlap.
//!
//! Two boxes are apart if and only if they are along a face normal of one or a cross product of two edges. For all boxes and cells of
//! one submap these axes are the same, so they are prepared once; along a row of cells each of them leaves an interval.

use super::tile::EDGE;
use nalgebra::Rotation3;

/// Overlaps of less than this count as none, cells: boxes that lie on the grid end where its cells do.
const SLIVER: f32 = 1e-3;
/// Edges whose directions differ by less are parallel, radians.
const PARALLEL: f32 = 1e-4;
/// Axes beside the cells' own: the box's three, and the nine cross products.
const AXES: usize = 12;

/// A cell for each bit, rows along x: row y + EDGE z.
#[derive(Clone)]
pub struct Bits(pub [u32; EDGE * EDGE]);

/// A box: centre and half its edges, in cells from the tile's corner; its edges lie along the stencil's axes.
#[derive(Clone, Copy, Debug)]
pub struct TurnedBox {
    pub centre: [f32; 3],
    pub half: [f32; 3],
}

/// Everything about a box's orientation.
pub struct Stencil {
    /// The box's edges: unit vectors in the cells' frame.
    edges: [[f32; 3]; 3],
    /// Coordinates of the axes, turned so that they point along x; and 1 / x.
    axes: [[f32; AXES]; 3],
    inverse: [f32; AXES],
    /// What half a box edge of 1 takes along each axis, and what half a cell does.
    own: [[f32; AXES]; 3],
    cell: [f32; AXES],
}

impl Stencil {
    /// For boxes turned by `rotation` against the cells.
    pub fn new(rotation: &Rotation3<f64>) -> Self {
        let edges: [[f32; 3]; 3] = std::array::from_fn(|j| std::array::from_fn(|k| rotation[(k, j)] as f32));
        let mut all = Vec::with_capacity(AXES);
        for [x, y, z] in edges {
            all.extend([[x, y, z], [0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]);
        }
        // Of edges that are parallel no axis is left, and none is needed.
        let unit = |n: [f32; 3]| {
            let norm = n.iter().map(|c| c * c).sum::<f32>().sqrt().copysign(n[0]);
            if norm.abs() < PARALLEL { [0.0; 3] } else { n.map(|c| c / norm) }
        };
        let all: [[f32; 3]; AXES] = std::array::from_fn(|i| unit(all[i]));
        let along = |n: [f32; 3], e: [f32; 3]| (0..3).map(|k| n[k] * e[k]).sum::<f32>().abs();
        Self {
            edges,
            axes: std::array::from_fn(|k| std::array::from_fn(|i| all[i][k])),
            // An axis across the rows tells all of a row or nothing: its interval becomes endless or empty.
            inverse: std::array::from_fn(|i| 1.0 / all[i][0].max(1e-12)),
            own: std::array::from_fn(|j| std::array::from_fn(|i| along(all[i], edges[j]))),
            cell: std::array::from_fn(|i| 0.5 * all[i].iter().map(|c| c.abs()).sum::<f32>() + if all[i] == [0.0; 3] { 1.0 } else { 0.0 }),
        }
    }

    /// Sets the cells that the box overlaps, in rows where `within` has any.
    pub fn draw(&self, what: &TurnedBox, within: &Bits, bits: &mut Bits) {
        let reach: [f32; 3] = std::array::from_fn(|k| (0..3).map(|j| what.half[j] * self.edges[j][k].abs()).sum::<f32>() - SLIVER);
        let extent: [f32; AXES] = std::array::from_fn(|i| (0..3).map(|j| what.half[j] * self.own[j][i]).sum::<f32>() + self.cell[i] - SLIVER);
        let range = |k: usize| cells(what.centre[k] - reach[k] - 0.5, what.centre[k] + reach[k] + 0.5);
        let (xs, ys, zs) = ([what.centre[0] - reach[0] - 0.5, what.centre[0] + reach[0] + 0.5], range(1), range(2));
        for z in zs {
            for y in ys.clone() {
                let row = y + EDGE * z;
                if within.0[row] == 0 {
                    continue;
                }
                let off = [0.0, y as f32 + 0.5 - what.centre[1], z as f32 + 0.5 - what.centre[2]];
                let [low, high] = self.interval(off, &extent);
                let xs = cells(xs[0].max(what.centre[0] + low), xs[1].min(what.centre[0] + high));
                if !xs.is_empty() {
                    bits.0[row] |= (u32::MAX >> (EDGE - xs.len())) << xs.start;
                }
            }
        }
    }

    /// Where along a row, from the box's centre, no axis parts the cell there from the box.
    #[inline(always)]
    fn interval(&self, off: [f32; 3], extent: &[f32; AXES]) -> [f32; 2] {
        let (mut low, mut high) = ([0f32; AXES], [0f32; AXES]);
        for i in 0..AXES {
            let aside = self.axes[1][i] * off[1] + self.axes[2][i] * off[2];
            low[i] = (-extent[i] - aside) * self.inverse[i];
            high[i] = (extent[i] - aside) * self.inverse[i];
        }
        [low.into_iter().fold(f32::NEG_INFINITY, f32::max), high.into_iter().fold(f32::INFINITY, f32::min)]
    }
}

/// The cells of a tile whose middles lie in an interval.
#[inline(always)]
fn cells(low: f32, high: f32) -> std::ops::Range<usize> {
    // Negative numbers become 0.
    (low + 0.5).floor() as usize..((high + 0.5).floor().min(EDGE as f32) as usize)
}
