//! Integration of scans into a submap (paper Sec. III-B, IV-B): select, update, propagate.
//!
//! ```text
//! Scan              a cloud and its pose, as it came                                   event
//!   PreparedScan    range image, returns, their planes; intensities, colours           sensor, mapper/frontend
//!   KeptScan        without the returns on things that move                            mapper/frontend
//!   SubmapScan      at its pose in the submap that was chosen, returns as ReturnsView  here
//!     rays          one per return, or per bundle of returns on a plane                rays
//!       voxels      of the TSDF and of occupancy                                       tsdf, occupancy
//! fusion step       a part of a submap that is to become part of another               mapper/background_fusion
//! ```
//!
//! [`TsdfIntegrator`] and [`OccupancyIntegrator`] each integrate scans into one field. A mapper with both fields transforms the returns once for both
//! (`both_fields`).

mod both_fields;
mod occupancy;
mod rays;
mod submap_scan;
mod tsdf;

pub(crate) use both_fields::FieldsMut;
pub use occupancy::{OccupancyIntegrator, OccupancyPhases, OccupancySettings, OccupancyStats};
pub use rays::returns::ReturnsView;
pub use rays::scale::ScaleRule;
pub(crate) use submap_scan::SubmapScan;
pub(crate) use tsdf::{EarlierBlocks, Redundancy};
pub use tsdf::{TsdfIntegrator, TsdfPhases, TsdfSettings, TsdfStats, colour_voxels};
