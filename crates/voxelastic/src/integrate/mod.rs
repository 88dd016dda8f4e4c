//! Integrating a scan into a submap (paper Sec. III-B, IV-B): select, update, propagate.

pub mod radix;
pub mod scale;
mod select;
mod transform;
pub mod tsdf;
mod walk;

pub use scale::ScaleRule;
pub use transform::Returns;
pub use tsdf::{TsdfIntegrator, TsdfPhases, TsdfSettings, TsdfStats};
