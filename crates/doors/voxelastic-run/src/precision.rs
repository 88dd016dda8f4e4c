//! Coordinates that single precision cannot hold: those of maps far from their origin, as in UTM.

use crate::warning::{Code, Warnings};
use crate::{Error, Result};
use voxelastic::Pose;
use voxelastic::atlas::Atlas;

/// Steps of single precision that are a larger part of a voxel are warned of.
const LARGE_STEP: f64 = 1.0 / 16.0;
/// Significant bits of single precision.
const BITS: i32 = 24;

/// Refuses a surface in the map frame of finest voxels of `voxel` metres where single precision has steps larger than a voxel; warns of steps that
/// can be seen.
///
/// # Errors
/// Steps larger than a voxel.
pub fn check(atlas: &Atlas, voxel: f32, warnings: &mut Warnings) -> Result<()> {
    let farthest = farthest(atlas);
    let (step, voxel) = (step_at(farthest), f64::from(voxel));
    let what = || format!("the map is {farthest:.0} m from its origin, where coordinates in single precision have steps of {step} m");
    if step > voxel {
        let remedy = "a session that was put too far away is taken out with `voxelastic remove MAP --session N` (`voxelastic info MAP` lists them); else map the data again: a map gets an origin near its first pose, so only poses that are far from that one are out of reach";
        return Err(Error::new(format!("{}, more than a voxel of {voxel:.3} m", what()), remedy));
    }
    if step > LARGE_STEP * voxel {
        warnings.add(Code::CoarseCoordinates, what(), "poses nearer to the origin avoid that");
    }
    Ok(())
}

/// Poses that are larger, metres, are mistakes: the Earth is not that wide.
pub const LARGEST: f64 = 1e8;
/// No vehicle has a lidar farther than this from its own frame, metres.
pub const LARGEST_VEHICLE: f64 = 1000.0;

/// A pose that is not farther than `most` metres from the origin of its frame.
///
/// # Errors
/// In words, where it is.
pub fn near(pose: Pose, most: f64) -> std::result::Result<Pose, String> {
    let distance = pose.translation.vector.norm();
    if distance <= most { Ok(pose) } else { Err(format!("lies {distance:.0} m from the origin, more than {most:.0} m: the unit is metres")) }
}

/// Why poses that count from a map's origin cannot be in it, where single precision has steps larger than a voxel of `voxel` metres; none if they can.
pub fn too_far<'a>(poses: impl IntoIterator<Item = &'a Pose>, voxel: f32) -> Option<String> {
    let coordinates = poses.into_iter().flat_map(|pose| pose.translation.vector.iter().copied());
    let farthest = coordinates.fold(0.0, |a: f64, b| if b.is_nan() { f64::INFINITY } else { a.max(b.abs()) });
    let step = step_at(farthest);
    let is_far = step > f64::from(voxel);
    is_far.then(|| {
        format!("it would lie {farthest:.0} m from the map's origin, where coordinates in single precision have steps of {step} m, more than a voxel")
    })
}

/// Largest coordinate of a root pose, metres.
fn farthest(atlas: &Atlas) -> f64 {
    atlas.submaps().iter().map(|submap| submap.t_map_submap().translation.vector.amax()).fold(0.0, f64::max)
}

/// Distance between neighbouring numbers of single precision at a coordinate.
fn step_at(coordinate: f64) -> f64 {
    if coordinate < 1.0 { f64::from(f32::EPSILON) } else { 2f64.powf(coordinate.log2().floor() + f64::from(1 - BITS)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_beyond_reason_are_told() {
        let [here, far, nowhere] = [5.0, 2e6, f64::NAN].map(|x| Pose::translation(0.0, x, 0.0));
        assert_eq!(too_far([&here], 0.1), None);
        assert!(
            too_far([&here, &far], 0.1).unwrap().contains("2000000 m") && too_far([&far], 0.3).is_none() && too_far([&nowhere, &here], 0.1).is_some()
        );
        assert!(near(far, LARGEST).is_ok() && near(far, LARGEST_VEHICLE).unwrap_err().contains("metres") && near(nowhere, LARGEST).is_err());
    }

    #[test]
    fn steps_are_those_of_single_precision() {
        for coordinate in [1.0f32, 3.5, 1023.9, 1024.0, 448_000.0, 5_411_000.0] {
            let next = f32::from_bits(coordinate.to_bits() + 1);
            assert_eq!(step_at(coordinate.into()), f64::from(next) - f64::from(coordinate), "{coordinate}");
        }
    }
}
