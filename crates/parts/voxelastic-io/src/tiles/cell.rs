//! Cells of the octree of tiles.

use super::LEAF_EDGE;

/// Cells are ordered, and joined to larger ones, by coordinates plus this: its bits alternate, so that both sides of the map's origin meet a few levels up.
const OFFSET: i32 = 0x0a_aaaa;
/// Bits of a coordinate.
const BITS: u32 = 21;

/// A cube of the octree: that of level 0 at `at` begins at that many times [`LEAF_EDGE`] voxels; those of the next level are twice as large.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cell {
    /// Level: 0 is full detail.
    pub level: u8,
    /// Coordinates among the cells of the level, not negative.
    coordinates: [u32; 3],
}

impl Cell {
    /// The cell of level 0 that contains a point of the map frame, metres, with finest voxels of `voxel` metres; none if the point is farther from the
    /// origin than half a million cells, or not finite.
    pub fn containing(point: [f64; 3], voxel: f64) -> Option<Self> {
        let at = point.map(|c| (c / (voxel * f64::from(LEAF_EDGE))).floor());
        at.iter().all(|c| c.abs() < f64::from(1 << 19)).then(|| Self::leaf(at.map(|c| c as i32)))
    }

    /// The cell of level 0 that begins at `at` times [`LEAF_EDGE`] voxels.
    fn leaf(at: [i32; 3]) -> Self {
        Self { level: 0, coordinates: at.map(|c| (c + OFFSET) as u32) }
    }

    /// A cell by what [`coordinates`](Self::coordinates) says.
    pub fn new(level: u8, coordinates: [u32; 3]) -> Option<Self> {
        (u32::from(level) < BITS && coordinates.iter().all(|c| *c < 1 << (BITS - u32::from(level)))).then_some(Self { level, coordinates })
    }

    /// Coordinates among the cells of the level.
    pub fn coordinates(&self) -> [u32; 3] {
        self.coordinates
    }

    /// The cell of the next level that contains this one.
    #[must_use]
    pub fn parent(&self) -> Self {
        Self { level: self.level + 1, coordinates: self.coordinates.map(|c| c >> 1) }
    }

    /// The cell of `level`, which is not below this one's, that contains this one.
    #[must_use]
    pub fn above(&self, level: u8) -> Self {
        Self { level, coordinates: self.coordinates.map(|c| c >> (level - self.level)) }
    }

    /// Least and largest coordinates in the map frame, metres, with finest voxels of `voxel` metres.
    pub fn bounds(&self, voxel: f64) -> ([f64; 3], [f64; 3]) {
        let leaf = voxel * f64::from(LEAF_EDGE);
        let at = |c: u32| (f64::from(c) * f64::from(1u32 << self.level) - f64::from(OFFSET)) * leaf;
        (self.coordinates.map(at), self.coordinates.map(|c| at(c + 1)))
    }

    /// Place in the order in which cells of one level come: that of a Morton curve.
    pub fn order(&self) -> u64 {
        let spread = |c: u32| (0..BITS).fold(0u64, |key, bit| key | u64::from(c >> bit & 1) << (3 * bit));
        let [x, y, z] = self.coordinates.map(spread);
        x | y << 1 | z << 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_contain_their_points_and_meet_above() {
        for point in [[0.0, 0.0, 0.0], [-0.1, 3.0, 12.9], [-4000.0, 812.5, -31.0]] {
            let cell = Cell::containing(point, 0.1).unwrap();
            let (low, high) = cell.bounds(0.1);
            assert!((0..3).all(|k| low[k] <= point[k] && point[k] < high[k]), "{point:?}: {low:?} {high:?}");
            let (low, high) = cell.parent().bounds(0.1);
            assert!((0..3).all(|k| low[k] <= point[k] && point[k] < high[k]));
            assert_eq!(Cell::new(cell.level, cell.coordinates()), Some(cell));
        }
        let [a, b] = [-1.0, 1.0].map(|x| Cell::containing([x, x, x], 0.1).unwrap());
        assert!(a.above(2) == b.above(2) && a.order() < b.order());
        assert_eq!(Cell::containing([f64::NAN, 0.0, 0.0], 0.1), None);
    }
}
