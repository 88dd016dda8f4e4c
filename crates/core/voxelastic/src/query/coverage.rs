//! Coverage of a shape by the union of several submaps' free spaces.

use super::atlas::PlacedField;
use super::collision::with_solid;
use super::shape::{OrientedBox, Shape};
use super::shape_sdf::{Both, BoxSolid, Solid};
use super::{AtlasQuery, UnknownAs};
use crate::geometry::Pose;

/// Largest number of halvings of a shape's bounding cube; shapes larger than 2^this finest voxels are divided into coarser cubes.
const MAX_HALVINGS: u32 = 12;

/// A cube of the map frame: coordinates in multiples of its own edge, from a common origin.
#[derive(Clone, Copy)]
struct Cell {
    at: [i32; 3],
    level: u32,
}

impl AtlasQuery<'_> {
    /// Whether the intersection of every map cube with the shape is free in some submap. `local` has the shape in the frames of the submaps
    /// whose bounds it overlaps.
    pub(super) fn is_covered(&self, shape: &Shape, local: &[(&PlacedField<'_>, Shape)]) -> bool {
        let (low, high) = shape.bounds();
        let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let level = ((extent / self.voxel_size()).max(1.0).log2().ceil() as u32).min(MAX_HALVINGS);
        let edge = self.voxel_size() * f64::from(1u32 << level);
        let [first, last] = [low, high].map(|p| p.map(|c| (c / edge).floor()));
        // Cubes and shape are compared near the origin, where single precision is sufficient.
        let origin = first.map(|c| c * edge);
        let shifted = shape.moved(&Pose::translation(-origin[0], -origin[1], -origin[2]));
        let coverage = Coverage { query: self, origin, local };
        let [nx, ny, nz] = std::array::from_fn(|k| (last[k] - first[k]) as i32);
        with_solid!(&shifted, 1.0 / self.voxel_size(), |solid| {
            (0..=nz).all(|z| (0..=ny).all(|y| (0..=nx).all(|x| coverage.is_covered(Cell { at: [x, y, z], level }, solid))))
        })
    }
}

/// A coverage check.
struct Coverage<'a, 'b> {
    query: &'a AtlasQuery<'b>,
    /// Smallest corner of the cell at zero, metres in the map frame.
    origin: [f64; 3],
    /// The shape in the frames of the submaps whose bounds it overlaps.
    local: &'a [(&'a PlacedField<'b>, Shape)],
}

impl Coverage<'_, '_> {
    fn is_covered<S: Solid>(&self, cell: Cell, shape: &S) -> bool {
        let corner = |add: i32| cell.at.map(|c| ((c + add) << cell.level) as f32);
        if !shape.meets(corner(0), corner(1)) {
            return true;
        }
        let edge = self.query.voxel_size() * f64::from(1u32 << cell.level);
        let middle: [f64; 3] = std::array::from_fn(|k| self.origin[k] + (f64::from(cell.at[k]) + 0.5) * edge);
        let t_map_cell = Pose::translation(middle[0], middle[1], middle[2]);
        let is_free = |(part, shape): &(&PlacedField<'_>, Shape)| {
            let per_metre = part.query.per_metre;
            let cube = BoxSolid::new(&OrientedBox { t_frame_box: part.t_submap_map * t_map_cell, half: [0.5 * edge; 3] }, per_metre);
            with_solid!(shape, per_metre, |solid| part.query.is_clear_of(&Both(solid, &cube), UnknownAs::Blocked))
        };
        if self.local.iter().any(is_free) {
            return true;
        }
        cell.level > 0
            && (0..8).all(|i| {
                let at = std::array::from_fn(|k| 2 * cell.at[k] + (i >> k & 1));
                self.is_covered(Cell { at, level: cell.level - 1 }, shape)
            })
    }
}
