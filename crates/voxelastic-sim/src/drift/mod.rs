//! What a SLAM system would know: odometry that drifts, loop edges, corrected poses.

mod backend;
mod loops;
mod odometry;

pub use backend::Correction;
pub(crate) use backend::corrections;
pub use loops::LoopSettings;
pub(crate) use loops::find as find_loops;
pub use odometry::drift_of;
pub(crate) use odometry::{drifted, edges as odometry_edges};

use crate::random::Stream;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;

/// A small random motion: standard deviations in metres and radians for each axis.
fn jolt(random: &mut Stream, metres: f64, radians: f64) -> Pose {
    let mut draw = |sigma: f64| Vector3::new(random.normal(), random.normal(), random.normal()) * sigma;
    let (shift, turn) = (draw(metres), draw(radians));
    Pose::from_parts(Translation3::from(shift), UnitQuaternion::new(turn))
}

/// Information (upper triangle of 6 x 6, order x y z roll pitch yaw) of independent errors with these standard deviations.
fn information(sigmas: [f64; 6]) -> [f64; 21] {
    let mut upper = [0.0; 21];
    let mut place = 0;
    for (row, sigma) in sigmas.iter().enumerate() {
        upper[place] = 1.0 / (sigma * sigma);
        place += 6 - row;
    }
    upper
}

#[cfg(test)]
mod tests;
