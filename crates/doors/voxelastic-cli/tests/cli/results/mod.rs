//! What is made of maps.

pub(super) mod colours;
pub(super) mod evaluation;
pub(super) mod exploration;
pub(super) mod grids;
pub(super) mod occupancy;
pub(super) mod planning;
pub(super) mod report;
pub(super) mod tiles;
