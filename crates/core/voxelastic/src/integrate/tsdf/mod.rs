//! MultiresTSDF integration (paper Sec. III-B): select the blocks along each ray, allocate them, update their voxels.

mod block_run;
mod colours;
mod integrator;
mod redundancy;
mod rescale;
mod settings;
mod truncation;
mod update;

pub use colours::colour_voxels;
pub use integrator::{TsdfIntegrator, TsdfPhases, TsdfStats};
pub(crate) use redundancy::{EarlierBlocks, Redundancy};
pub use settings::TsdfSettings;
