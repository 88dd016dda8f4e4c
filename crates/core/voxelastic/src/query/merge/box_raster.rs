//! Rasterises rotated boxes into a tile of cells, exactly: a cell is set if it overlaps the box.
//!
//! Two boxes are disjoint if and only if a face normal of one or a cross product of two edges separates them. These axes are the same for all
//! voxels of a submap, so they are computed once; along a row of cells each axis leaves an interval.

use super::tile_mask::{TILE_EDGE, TileMask};
use nalgebra::Rotation3;

/// Overlaps of less than this many cells are ignored: boxes aligned with the grid end at cell faces.
const MIN_OVERLAP: f32 = 1e-3;
/// Edges whose directions differ by less than this angle are parallel, radians.
const PARALLEL: f32 = 1e-4;
/// Separating axes besides the cells' own: the box's three and the nine cross products.
const AXES: usize = 12;

/// A box: centre and half edges in cells from the tile's corner; its orientation is that of the [`BoxRaster`].
#[derive(Clone, Copy, Debug)]
pub(super) struct RotatedBox {
    pub centre: [f32; 3],
    pub half: [f32; 3],
}

/// Rasteriser of boxes of one orientation.
pub(super) struct BoxRaster {
    /// The box's edges: unit vectors in the cells' frame.
    edges: [[f32; 3]; 3],
    /// Coordinates of the axes, with the sign that makes x positive; and 1 / x.
    axes: [[f32; AXES]; 3],
    inverse: [f32; AXES],
    /// Extents along each axis of a box with half edges of 1, and of half a cell.
    own: [[f32; AXES]; 3],
    cell: [f32; AXES],
}

impl BoxRaster {
    /// For boxes rotated by `rotation` against the cells.
    pub fn new(rotation: &Rotation3<f64>) -> Self {
        let edges: [[f32; 3]; 3] = std::array::from_fn(|j| std::array::from_fn(|k| rotation[(k, j)] as f32));
        let mut all = Vec::with_capacity(AXES);
        for [x, y, z] in edges {
            all.extend([[x, y, z], [0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]);
        }
        // Parallel edges have no cross product, and need none.
        let unit = |n: [f32; 3]| {
            let norm = n.iter().map(|c| c * c).sum::<f32>().sqrt().copysign(n[0]);
            if norm.abs() < PARALLEL { [0.0; 3] } else { n.map(|c| c / norm) }
        };
        let all: [[f32; 3]; AXES] = std::array::from_fn(|i| unit(all[i]));
        let along = |n: [f32; 3], e: [f32; 3]| (0..3).map(|k| n[k] * e[k]).sum::<f32>().abs();
        Self {
            edges,
            axes: std::array::from_fn(|k| std::array::from_fn(|i| all[i][k])),
            // An axis perpendicular to the rows leaves all of a row or nothing.
            inverse: std::array::from_fn(|i| 1.0 / all[i][0].max(1e-12)),
            own: std::array::from_fn(|j| std::array::from_fn(|i| along(all[i], edges[j]))),
            cell: std::array::from_fn(|i| 0.5 * all[i].iter().map(|c| c.abs()).sum::<f32>() + if all[i] == [0.0; 3] { 1.0 } else { 0.0 }),
        }
    }

    /// Sets the cells that the box overlaps, in rows where `within` has any cell set.
    pub fn fill(&self, rotated: &RotatedBox, within: &TileMask, mask: &mut TileMask) {
        let reach: [f32; 3] = std::array::from_fn(|k| (0..3).map(|j| rotated.half[j] * self.edges[j][k].abs()).sum::<f32>() - MIN_OVERLAP);
        let extent: [f32; AXES] = std::array::from_fn(|i| (0..3).map(|j| rotated.half[j] * self.own[j][i]).sum::<f32>() + self.cell[i] - MIN_OVERLAP);
        let range = |k: usize| cells(rotated.centre[k] - reach[k] - 0.5, rotated.centre[k] + reach[k] + 0.5);
        let (xs, ys, zs) = ([rotated.centre[0] - reach[0] - 0.5, rotated.centre[0] + reach[0] + 0.5], range(1), range(2));
        for z in zs {
            for y in ys.clone() {
                let row = y + TILE_EDGE * z;
                if within.0[row] == 0 {
                    continue;
                }
                let off = [0.0, y as f32 + 0.5 - rotated.centre[1], z as f32 + 0.5 - rotated.centre[2]];
                let [low, high] = self.interval(off, &extent);
                let xs = cells(xs[0].max(rotated.centre[0] + low), xs[1].min(rotated.centre[0] + high));
                if !xs.is_empty() {
                    mask.0[row] |= (u32::MAX >> (TILE_EDGE - xs.len())) << xs.start;
                }
            }
        }
    }

    /// Interval along a row, from the box's centre, in which no axis separates cells from the box.
    #[inline(always)]
    fn interval(&self, off: [f32; 3], extent: &[f32; AXES]) -> [f32; 2] {
        let (mut low, mut high) = ([0f32; AXES], [0f32; AXES]);
        for i in 0..AXES {
            let across = self.axes[1][i] * off[1] + self.axes[2][i] * off[2];
            low[i] = (-extent[i] - across) * self.inverse[i];
            high[i] = (extent[i] - across) * self.inverse[i];
        }
        [low.into_iter().fold(f32::NEG_INFINITY, f32::max), high.into_iter().fold(f32::INFINITY, f32::min)]
    }
}

/// The cells of a tile whose centres lie in an interval.
#[inline(always)]
fn cells(low: f32, high: f32) -> std::ops::Range<usize> {
    // Negative numbers become 0.
    (low + 0.5).floor() as usize..((high + 0.5).floor().min(TILE_EDGE as f32) as usize)
}
