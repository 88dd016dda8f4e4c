//! MultiresOFusion integration (paper Sec. III-A, III-B): descend for free space, walk beams for surfaces.

mod allocate;
mod apply;
mod descend;
mod found;
mod gaps;
mod integrator;
mod model;
pub(crate) mod propagate;
mod rows;
mod sight;
mod silhouette;
mod texel;
mod visibility;

pub use integrator::{OccupancyIntegrator, OccupancyPhases, OccupancyStats};
pub use model::OccupancySettings;
