//! Normally distributed errors of poses.

use crate::random::Stream;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;

/// A random motion with standard deviations in metres and radians per axis.
pub(super) fn random_motion(random: &mut Stream, metres: f64, radians: f64) -> Pose {
    let mut draw = |sigma: f64| Vector3::new(random.normal(), random.normal(), random.normal()) * sigma;
    let (shift, turn) = (draw(metres), draw(radians));
    Pose::from_parts(Translation3::from(shift), UnitQuaternion::new(turn))
}

/// Information matrix (upper triangle of 6 x 6, order x y z roll pitch yaw) of independent errors with these standard deviations.
pub(super) fn information(sigmas: [f64; 6]) -> [f64; 21] {
    let mut upper = [0.0; 21];
    let mut index = 0;
    for (row, sigma) in sigmas.iter().enumerate() {
        upper[index] = 1.0 / (sigma * sigma);
        index += 6 - row;
    }
    upper
}
