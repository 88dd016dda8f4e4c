//! A scan as surfels: the points of small cells, whose edges grow with range, each as a mean and a covariance.

use crate::registration::{VoxelIndex, key};
use voxelastic::geometry::smallest_eigenvector;

/// Ranges from which cells are twice, four times and eight times as wide, in edges of the smallest.
const WIDER_FROM: [f32; 3] = [50.0, 100.0, 200.0];
/// Fewer points than this tell nothing of the surface.
const LEAST_POINTS: f64 = 4.0;
/// A plane needs this many points.
const LEAST_FOR_PLANE: f64 = 6.0;
/// The spread of a plane's points across it, as a share of their smaller spread within it (standard deviations), and in metres.
const FLATNESS: (f64, f64) = (0.3, 0.06);
/// The smaller spread within a plane, in edges of its cell: less, and the points are a line, like those of a single beam.
const LEAST_WIDTH: f64 = 0.08;
/// The spread across a line of points, metres: more, and they are no surface.
const LEAST_LINE: f64 = 0.06;

/// A piece of a scan's surface, in the lidar frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surfel {
    /// Mean of its points, metres.
    pub(super) mean: [f32; 3],
    /// Covariance of its points: xx xy xz yy yz zz.
    pub(super) covariance: [f32; 6],
    /// Unit normal that looks towards the sensor; zero where the points are a line.
    pub(super) normal: [f32; 3],
    /// Number of points.
    pub(super) count: f32,
}

impl Surfel {
    /// Whether it has a normal.
    pub(super) fn is_plane(&self) -> bool {
        self.normal != [0.0; 3]
    }

    /// Variance of its points along a direction in the lidar frame.
    pub(super) fn variance_along(&self, [x, y, z]: [f64; 3]) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.covariance.map(f64::from);
        (xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)).max(0.0)
    }
}

/// What refinement keeps of a scan.
#[derive(Clone, Debug, Default)]
pub struct ScanSurface {
    pub(super) surfels: Vec<Surfel>,
}

/// Sums over the points of a cell, relative to its first point.
#[derive(Clone, Copy)]
struct Sums {
    first: [f32; 3],
    edge: f32,
    count: f64,
    sum: [f64; 3],
    squares: [f64; 6],
}

impl ScanSurface {
    /// The surface of a scan: its returns in the lidar frame at its time stamp, metres; `cell` is the edge of the cells near the sensor, metres.
    pub fn of(points: &[[f32; 3]], cell: f32) -> Self {
        let mut index = VoxelIndex::with_capacity(4096);
        let mut cells: Vec<Sums> = Vec::new();
        for p in points {
            let range = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            if !range.is_finite() {
                continue;
            }
            let level = WIDER_FROM.iter().filter(|from| range > **from * cell).count();
            let edge = cell * (1 << level) as f32;
            // Cells of different edges must not meet under one key: each level has a shift of its own.
            let shift = 100_000 * level as i32;
            let coordinates = p.map(|v| (v / edge).floor() as i32);
            let (place, is_new) = index.get_or_insert(key([coordinates[0] + shift, coordinates[1], coordinates[2]]), cells.len() as u32);
            if is_new {
                cells.push(Sums { first: *p, edge, count: 0.0, sum: [0.0; 3], squares: [0.0; 6] });
            }
            let cell = &mut cells[place as usize];
            let [x, y, z]: [f64; 3] = std::array::from_fn(|i| f64::from(p[i] - cell.first[i]));
            cell.count += 1.0;
            cell.sum = [cell.sum[0] + x, cell.sum[1] + y, cell.sum[2] + z];
            for (sum, product) in cell.squares.iter_mut().zip([x * x, x * y, x * z, y * y, y * z, z * z]) {
                *sum += product;
            }
        }
        Self { surfels: cells.iter().filter_map(surfel).collect() }
    }

    /// Number of its surfels.
    pub fn len(&self) -> usize {
        self.surfels.len()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.surfels.is_empty()
    }

    /// The share of its surfels that are planes.
    pub fn planarity(&self) -> f64 {
        self.surfels.iter().filter(|s| s.is_plane()).count() as f64 / self.len().max(1) as f64
    }
}

/// The surfel of a cell, if its points are a plane or a line.
fn surfel(cell: &Sums) -> Option<Surfel> {
    if cell.count < LEAST_POINTS {
        return None;
    }
    let offset = cell.sum.map(|v| v / cell.count);
    let product = |k: usize, i: usize, j: usize| cell.squares[k] / cell.count - offset[i] * offset[j];
    let covariance = [product(0, 0, 0), product(1, 0, 1), product(2, 0, 2), product(3, 1, 1), product(4, 1, 2), product(5, 2, 2)];
    let ([low, middle, _], normal) = smallest_eigenvector(covariance);
    let mean: [f32; 3] = std::array::from_fn(|i| cell.first[i] + offset[i] as f32);
    let surfel = |normal| Some(Surfel { mean, covariance: covariance.map(|v| v as f32), normal, count: cell.count as f32 });
    let is_wide = middle > (LEAST_WIDTH * f64::from(cell.edge)).powi(2);
    let is_flat = low < FLATNESS.0 * FLATNESS.0 * middle && low < FLATNESS.1 * FLATNESS.1;
    match normal {
        Some(normal) if is_wide && is_flat && cell.count >= LEAST_FOR_PLANE => {
            let towards: f64 = (0..3).map(|i| normal[i] * f64::from(mean[i])).sum();
            surfel(normal.map(|v| if towards > 0.0 { -v as f32 } else { v as f32 }))
        }
        _ if !is_wide && middle < LEAST_LINE * LEAST_LINE => surfel([0.0; 3]),
        _ => None,
    }
}
