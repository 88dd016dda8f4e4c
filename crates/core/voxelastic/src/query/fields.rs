//! What an atlas can be asked: its occupancy, its surfaces, or an error where it does not hold them.

use super::{AtlasQuery, DistanceQuery};
use crate::atlas::Atlas;

/// The field that a query asks is not in the map, which holds the other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MissingField {
    /// The map has surfaces only, so nothing says what is free and what is unknown.
    #[error("the map has no occupancy, only surfaces: map with the field occupancy or both")]
    Occupancy,
    /// The map has occupancy only, so nothing says where surfaces are within a voxel.
    #[error("the map has no surfaces, only occupancy: map with the field tsdf or both")]
    Surfaces,
}

impl Atlas {
    /// Queries on the occupancy of all submaps in the map frame. Of a map without any observation, all is unknown.
    ///
    /// ```
    /// use voxelastic::atlas::Atlas;
    /// use voxelastic::field::occupancy::State;
    /// let atlas = Atlas::new(0.065);
    /// assert_eq!(atlas.query().unwrap().state([1.0, 2.0, 0.5]), State::Unknown);
    /// ```
    ///
    /// # Errors
    /// [`MissingField::Occupancy`] where the map holds surfaces only; [`AtlasQuery::new`] answers unknown instead.
    pub fn query(&self) -> Result<AtlasQuery<'_>, MissingField> {
        let query = AtlasQuery::new(self);
        if query.is_empty() && !self.tsdfs().is_empty() { Err(MissingField::Occupancy) } else { Ok(query) }
    }

    /// Queries on the surfaces (TSDF) of all submaps in the map frame. In a map without any observation, no distance is known.
    ///
    /// # Errors
    /// [`MissingField::Surfaces`] where the map holds occupancy only; [`DistanceQuery::new`] finds no distance instead.
    pub fn distances(&self) -> Result<DistanceQuery<'_>, MissingField> {
        let query = DistanceQuery::new(self);
        if query.is_empty() && !AtlasQuery::new(self).is_empty() { Err(MissingField::Surfaces) } else { Ok(query) }
    }
}
