//! A simulated SLAM system: drifting odometry, loop edges, corrected poses.

mod correction;
mod gaussian;
mod live;
mod loops;
mod odometry;

pub use correction::Correction;
pub(crate) use correction::corrections;
pub use live::{LiveSlam, Tracked};
pub use loops::LoopSettings;
pub(crate) use loops::find as find_loops;
pub use odometry::mean_drift;
pub(crate) use odometry::{drifting_odometry, edges as odometry_edges};

#[cfg(test)]
mod tests;
