//! A smooth displacement: one vector per cell, interpolated between the middles of cells.

use super::super::placement::{Placement, floor};
use crate::octree::{BLOCK_EDGE, block_coords, block_key};
use hashbrown::HashMap;

/// Edge of a cell, finest voxels: eight blocks. Cells are nodes of the octree, so that its cubes of 4 x 4 x 4 blocks, in which fields are sampled, lie between the
/// middles of eight cells.
const EDGE: f32 = 64.0;
/// The lowest corner of cell 0 along each axis, finest voxels: nodes of the octree do not begin at the origin.
const LOW: f32 = (block_coords(block_key([0; 3]) >> KEY_BITS << KEY_BITS)[0] * BLOCK_EDGE as i32) as f32;
/// Key bits of a block within a cell.
const KEY_BITS: u32 = 9;

/// A cell by its position, in cells.
pub(super) type Cell = [i32; 3];

/// The cell that contains a point, finest voxels.
pub(super) fn cell_of(point: [f32; 3]) -> Cell {
    point.map(|c| floor((c - LOW) / EDGE))
}

/// The middle of a cell, finest voxels.
pub(super) fn middle_of(cell: Cell) -> [f32; 3] {
    cell.map(|c| (c as f32 + 0.5) * EDGE + LOW)
}

/// How much a field is moved at a place of the lattice that it is sampled in, finest voxels.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::atlas::fusion) struct Displacement {
    vectors: HashMap<Cell, [f32; 3]>,
}

impl Displacement {
    /// A displacement by the vectors of cells. Cells around these get the mean of their neighbours, two cells far, so that the field is moved as a whole; beyond
    /// them nothing is moved.
    pub fn new(cells: impl Iterator<Item = (Cell, [f32; 3])>) -> Self {
        let mut vectors: HashMap<Cell, [f32; 3]> = cells.collect();
        for _ in 0..2 {
            let mut sums: HashMap<Cell, ([f64; 3], f64)> = HashMap::new();
            let mut known: Vec<(Cell, [f32; 3])> = vectors.iter().map(|(cell, vector)| (*cell, *vector)).collect();
            known.sort_unstable_by_key(|(cell, _)| *cell);
            for (cell, vector) in known {
                for near in around(cell).filter(|near| !vectors.contains_key(near)) {
                    let (sum, count) = sums.entry(near).or_default();
                    *sum = std::array::from_fn(|k| sum[k] + f64::from(vector[k]));
                    *count += 1.0;
                }
            }
            vectors.extend(sums.into_iter().map(|(cell, (sum, count))| (cell, sum.map(|v| (v / count) as f32))));
        }
        if vectors.values().all(|vector| *vector == [0.0; 3]) {
            vectors.clear();
        }
        Self { vectors }
    }

    /// Whether nothing is moved.
    pub fn is_zero(&self) -> bool {
        self.vectors.is_empty()
    }

    /// The vector of a cell.
    pub(super) fn of_cell(&self, cell: &Cell) -> [f32; 3] {
        self.vectors.get(cell).copied().unwrap_or_default()
    }

    /// The vector at a point: trilinear between the middles of cells.
    pub fn at(&self, point: [f32; 3]) -> [f32; 3] {
        if self.is_zero() {
            return [0.0; 3];
        }
        let at = point.map(|c| (c - LOW) / EDGE - 0.5);
        let base = at.map(floor);
        let corners = std::array::from_fn(|i| self.of_cell(&std::array::from_fn(|k| base[k] + (i >> k & 1) as i32)));
        trilinear(&corners, std::array::from_fn(|k| at[k] - base[k] as f32))
    }

    /// What is added to the coordinates of points of a cube in the field's own lattice: the cube has its lowest corner at `low` and edges of `edge` finest voxels,
    /// and must lie between the middles of eight cells.
    pub fn over(&self, placement: &Placement, low: [f32; 3], edge: f32) -> CubeOffset {
        let corner = |i: usize| {
            let moved = self.at(std::array::from_fn(|k| low[k] + (i >> k & 1) as f32 * edge));
            placement.t_source_target.rotate(moved).map(|v| -v)
        };
        CubeOffset { low, edge, corners: if self.is_zero() { [[0.0; 3]; 8] } else { std::array::from_fn(corner) } }
    }
}

/// Offsets within a cube, trilinear between its corners; bit k of a corner's number is its side along axis k.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::atlas::fusion) struct CubeOffset {
    low: [f32; 3],
    edge: f32,
    pub corners: [[f32; 3]; 8],
}

impl CubeOffset {
    /// The offset at a point of the cube.
    pub fn at(&self, point: [f32; 3]) -> [f32; 3] {
        if self.corners == [[0.0; 3]; 8] {
            return [0.0; 3];
        }
        trilinear(&self.corners, std::array::from_fn(|k| (point[k] - self.low[k]) / self.edge))
    }

    /// The offsets within a smaller cube in it.
    pub fn within(&self, low: [f32; 3], edge: f32) -> Self {
        Self { low, edge, corners: std::array::from_fn(|i| self.at(std::array::from_fn(|k| low[k] + (i >> k & 1) as f32 * edge))) }
    }

    /// The mean of the corners, and how much a corner differs from it at most along an axis.
    pub fn mean_and_spread(&self) -> ([f32; 3], f32) {
        let mean: [f32; 3] = std::array::from_fn(|k| self.corners.iter().map(|corner| corner[k]).sum::<f32>() / 8.0);
        let spread = self.corners.iter().flat_map(|corner| [0, 1, 2].map(|k| (corner[k] - mean[k]).abs())).fold(0.0, f32::max);
        (mean, spread)
    }
}

/// The value at `fraction` between eight corners.
fn trilinear(corners: &[[f32; 3]; 8], fraction: [f32; 3]) -> [f32; 3] {
    let mut value = [0.0; 3];
    for (i, corner) in corners.iter().enumerate() {
        let share: f32 = (0..3).map(|k| if i >> k & 1 == 1 { fraction[k] } else { 1.0 - fraction[k] }).product();
        (0..3).for_each(|k| value[k] += share * corner[k]);
    }
    value
}

/// The 27 cells around a cell, itself included.
pub(super) fn around(cell: Cell) -> impl Iterator<Item = Cell> {
    (0..27).map(move |i| [cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1])
}
