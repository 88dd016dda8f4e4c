//! Integration of scans into a submap (paper Sec. III-B, IV-B): select, update, propagate.
//!
//! [`TsdfIntegrator`] and [`OccupancyIntegrator`] each integrate scans into one field. A mapper with both fields transforms the returns once for both
//! (`both_fields`).

mod both_fields;
mod occupancy;
mod rays;
mod tsdf;

pub(crate) use both_fields::{FieldIntegrators, FieldsMut, ScanInput};
pub use occupancy::{OccupancyIntegrator, OccupancyPhases, OccupancySettings, OccupancyStats};
pub use rays::returns::ReturnsView;
pub use rays::scale::ScaleRule;
pub(crate) use tsdf::{EarlierBlocks, Redundancy};
pub use tsdf::{TsdfIntegrator, TsdfPhases, TsdfSettings, TsdfStats, integrate_colours};
