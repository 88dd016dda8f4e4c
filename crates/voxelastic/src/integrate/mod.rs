//! Integrating a scan into a submap (paper Sec. III-B, IV-B): select, update, propagate.

mod band;
mod bundle;
mod colour;
mod formation;
mod known;
pub mod occupancy;
pub mod radix;
mod rescale;
pub mod scale;
mod select;
mod transform;
pub mod tsdf;
mod walk;

pub use colour::paint;
pub(crate) use known::Known;
pub use occupancy::{OccupancyIntegrator, OccupancyPhases, OccupancySettings, OccupancyStats};
pub use scale::ScaleRule;
pub use transform::Returns;
pub use tsdf::{TsdfIntegrator, TsdfPhases, TsdfSettings, TsdfStats};
