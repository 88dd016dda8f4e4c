//! MultiresOFusion integration (paper Sec. III-A, III-B): free space by a descent from the root of the tree, surfaces by walking rays.

mod allocate;
mod apply;
mod block_task;
mod classify;
mod cube;
mod descend;
mod evidence;
mod extent;
mod fill_holes;
mod free_cells;
mod integrator;
mod own_space;
mod range_pyramid;
mod row_table;
mod run_table;
mod settings;
mod texel;
mod update_blocks;

pub(crate) use integrator::Rays;
pub use integrator::{OccupancyIntegrator, OccupancyPhases, OccupancyStats};
pub use settings::OccupancySettings;
