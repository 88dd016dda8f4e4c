//! The comparison of two maps.

use super::fit::{Fit, Margins};
use super::pieces::{ChangedPiece, area, pieces};
use super::void::are_void;
use crate::atlas::Atlas;
use crate::field::occupancy::State;
use crate::query::AtlasQuery;
use crate::surface::{Mesh, MeshOptions};

/// How two maps are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct ChangeOptions {
    /// How far from a changed surface the other map must know nothing but free space, metres: more than the two maps lie beside each other.
    pub margin: f64,
    /// Whether the margin is wider where the maps fit less well: twice as wide as three quarters of the surfaces around that face one way lie beside the other map's, at most.
    /// Nothing has changed where most surfaces along one axis have none of the other map within half a metre.
    pub is_fitted: bool,
    /// Smallest area of a piece, square metres. Smaller ones are not listed.
    pub least_area: f64,
    /// The surfaces.
    pub mesh: MeshOptions,
}

impl ChangeOptions {
    /// A margin of three voxels, at least 15 cm, wider where maps fit less well, and pieces from 0.1 square metres on, for maps of voxels of `voxel_size` metres.
    pub fn for_voxels(voxel_size: f32) -> Self {
        Self { margin: (3.0 * f64::from(voxel_size)).max(0.15), is_fitted: true, least_area: 0.1, mesh: MeshOptions::default() }
    }
}

/// Why two maps cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ChangeError {
    /// One of the maps has no surfaces.
    #[error("the {0} map has no surfaces")]
    NoSurfaces(&'static str),
    /// One of the maps has no occupancy.
    #[error("the {0} map has no occupancy, so nothing says where space was free")]
    NoOccupancy(&'static str),
    /// The margin or the area is negative, not finite, or far too large.
    #[error("a margin is 0 to 10 metres, and an area is not negative")]
    Options,
}

/// What changed between two maps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// Surfaces of the newer map where the older one knows free space, largest first.
    pub appeared: Vec<ChangedPiece>,
    /// Surfaces of the older map where the newer one knows free space, largest first.
    pub vanished: Vec<ChangedPiece>,
    /// Area of the newer map's surface at places that the older one observed, as free or as occupied, square metres.
    pub compared_area: f64,
    /// Area of the newer map's surface, square metres.
    pub area: f64,
    /// The widest margin that was taken, metres.
    pub widest_margin: f64,
    /// The newer map's surface, map frame, metres.
    pub surface: Mesh,
}

/// Compares two maps in one frame. Runs in parallel; the result does not depend on the number of threads.
///
/// ```
/// use voxelastic::atlas::Atlas;
/// use voxelastic::changes::{ChangeError, ChangeOptions, changes};
/// let empty = Atlas::new(0.065);
/// assert_eq!(changes(&empty, &empty, &ChangeOptions::for_voxels(0.065)), Err(ChangeError::NoSurfaces("older")));
/// ```
///
/// # Errors
/// Maps without surfaces or without occupancy, and options out of range.
pub fn changes(before: &Atlas, after: &Atlas, options: &ChangeOptions) -> Result<Changes, ChangeError> {
    if !(0.0..=10.0).contains(&options.margin) || options.least_area.is_nan() || options.least_area < 0.0 {
        return Err(ChangeError::Options);
    }
    for (name, atlas) in [("older", before), ("newer", after)] {
        if atlas.tsdfs().is_empty() {
            return Err(ChangeError::NoSurfaces(name));
        }
        if AtlasQuery::new(atlas).is_empty() {
            return Err(ChangeError::NoOccupancy(name));
        }
    }
    let (older, newer) = (AtlasQuery::new(before), AtlasQuery::new(after));
    let mesh = after.mesh(&options.mesh);
    let states = older.states(&mesh.positions);
    let margins = |atlas: &Atlas, other| match options.is_fitted {
        true => Fit::of(atlas.submaps(), other, options.margin).margins(),
        false => Margins::even(options.margin),
    };
    let (of_appeared, of_vanished) = (margins(after, &older), margins(before, &newer));
    let appeared = changed(&mesh, &states, (&older, &of_appeared), options);
    let is_compared = |triangle: &&[u32; 3]| triangle.iter().any(|&vertex| states[vertex as usize] != State::Unknown);
    let area_of = |triangle: &[u32; 3]| area(&mesh, *triangle);
    let compared_area = mesh.triangles.iter().filter(is_compared).map(area_of).sum();
    let area = mesh.triangles.iter().map(area_of).sum();
    let old_mesh = before.mesh(&options.mesh);
    let vanished = changed(&old_mesh, &newer.states(&old_mesh.positions), (&newer, &of_vanished), options);
    let widest_margin = of_appeared.widest().max(of_vanished.widest());
    Ok(Changes { appeared, vanished, compared_area, area, widest_margin, surface: mesh })
}

/// The pieces of a surface where the `other` map, in which its vertices have `states`, knows free space only, with these margins.
fn changed(mesh: &Mesh, states: &[State], (other, margins): (&AtlasQuery<'_>, &Margins), options: &ChangeOptions) -> Vec<ChangedPiece> {
    let is_changed = are_void(other, &mesh.positions, states, |p| margins.at(p));
    pieces(mesh, |triangle| triangle.iter().all(|&vertex| is_changed[vertex as usize]), options.margin.max(0.05), options.least_area)
}
