//! Registration to a whole place, from a guess.

use super::overlap::Guess;
use super::place::{Place, levels};
use crate::registration::{Registration, RegistrationSettings, Surfel, ranked, search};
use nalgebra::{Translation3, Vector3};
use voxelastic::geometry::Pose;

/// Heights around the guess from which the registration starts, in voxels.
const HEIGHTS: [f64; 3] = [0.0, -3.0, 3.0];

/// Settings of registrations between places.
pub(crate) fn settings(voxel: f64) -> RegistrationSettings {
    RegistrationSettings { max_iterations: 50, convergence: 1e-3, least_scale: 0.3 * voxel, point_weight: 1.0 }
}

/// Registers points to a place, from some heights around a guess.
pub(crate) fn align(place: &Place, points: &[Surfel], guess: &Guess, voxel: f64) -> Option<Registration> {
    let start = |height: &f64| {
        let up = place.level.inverse() * Vector3::new(0.0, 0.0, height * voxel);
        let guess = &guess.t_first_second;
        Pose::from_parts(Translation3::from(guess.translation.vector + up), guess.rotation)
    };
    let starts: Vec<Pose> = HEIGHTS.iter().map(start).collect();
    ranked(search(points, &starts, &levels(&place.scans, voxel), &settings(voxel))).into_iter().next()
}
