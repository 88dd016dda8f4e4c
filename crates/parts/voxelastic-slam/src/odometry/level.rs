//! Which way is up in the first scan: by gravity, or by the ground and the walls where these agree.

use crate::registration::Surfel;
use nalgebra::{Matrix3, SymmetricEigen, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use voxelastic::geometry::Pose;

/// What told how the map frame is levelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Level {
    /// Nothing: the map frame is tilted as the first scan was.
    #[default]
    Unknown,
    /// The inertial measurement unit, at rest during the first scan.
    Gravity,
    /// The ground and the walls of the first scan.
    Surfaces,
}

/// Angles to the vertical or the horizontal within which surfaces count, degrees, one refinement after the other.
const WITHIN: [f64; 4] = [25.0, 12.0, 6.0, 3.0];
/// Shares of all planes that must be level or upright, that must be upright, and that must be level or upright across the walls.
const LEAST_SHARES: [f64; 3] = [0.5, 0.15, 0.08];
/// Planes that are needed.
const LEAST_PLANES: usize = 60;

/// The direction up in the lidar frame, if level and upright surfaces agree on it: both, since the ground alone may be a slope. The sensor must be
/// tilted by less than 25 degrees.
pub(super) fn up(surfels: &[Surfel]) -> Option<Vector3<f64>> {
    let normals: Vec<Vector3<f64>> = surfels.iter().map(|s| Vector3::from(s.normal.map(f64::from))).filter(|n| n.norm_squared() > 0.5).collect();
    if normals.len() < LEAST_PLANES {
        return None;
    }
    let mut up = Vector3::z();
    for degrees in WITHIN {
        let (level, upright, _) = moments(&normals, &up, degrees.to_radians());
        // Level normals are to lie along it, upright ones across.
        let eigen = SymmetricEigen::new(level - upright);
        let best = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        up = if best.z < 0.0 { -best } else { best };
    }
    let within = WITHIN[WITHIN.len() - 1].to_radians();
    let (level, upright, counted) = moments(&normals, &up, within);
    let all = normals.len() as f64;
    let mut walls = SymmetricEigen::new(upright).eigenvalues;
    walls.as_mut_slice().sort_by(f64::total_cmp);
    // The walls' second direction and the ground hold the tilt across the walls' first.
    let across = walls[1] + level.trace();
    let shares = [counted / all, upright.trace() / all, across / all];
    let is_sure = shares.iter().zip(LEAST_SHARES).all(|(share, least)| *share >= least) && up.z > WITHIN[0].to_radians().cos();
    is_sure.then_some(up)
}

/// Sums of the outer products of level and of upright normals, and their number.
fn moments(normals: &[Vector3<f64>], up: &Vector3<f64>, within: f64) -> (Matrix3<f64>, Matrix3<f64>, f64) {
    let (cos, sin) = (within.cos(), within.sin());
    let (mut level, mut upright, mut count) = (Matrix3::zeros(), Matrix3::zeros(), 0.0);
    for n in normals {
        let along = n.dot(up).abs();
        let sums = if along > cos {
            &mut level
        } else if along < sin {
            &mut upright
        } else {
            continue;
        };
        *sums += n * n.transpose();
        count += 1.0;
    }
    (level, upright, count)
}

/// The pose of a lidar at the map's origin for which `up` (lidar frame) is the map's z, turned as little as possible.
pub(super) fn levelled(up: &Vector3<f64>) -> Pose {
    let rotation = UnitQuaternion::rotation_between(up, &Vector3::z()).unwrap_or_else(UnitQuaternion::identity);
    Pose::from_parts(nalgebra::Translation3::identity(), rotation)
}
