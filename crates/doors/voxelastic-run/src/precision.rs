//! Coordinates that single precision cannot hold: those of maps far from their origin, as in UTM.

use crate::warning::{Code, Warnings};
use crate::{Error, Result};
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
        let remedy = "map the data again: a map gets an origin near its first pose, so only poses that are far from that one are out of reach";
        return Err(Error::new(format!("{}, more than a voxel of {voxel:.3} m", what()), remedy));
    }
    if step > LARGE_STEP * voxel {
        warnings.add(Code::CoarseCoordinates, what(), "poses nearer to the origin avoid that");
    }
    Ok(())
}

/// Largest coordinate of a root pose, metres.
fn farthest(atlas: &Atlas) -> f64 {
    atlas.submaps().iter().map(|submap| submap.t_map_submap().translation.vector.amax()).fold(0.0, f64::max)
}

/// Distance between neighbouring numbers of single precision at a coordinate.
fn step_at(coordinate: f64) -> f64 {
    if coordinate < 1.0 { f64::from(f32::EPSILON) } else { 2f64.powi(coordinate.log2().floor() as i32 + 1 - BITS) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_those_of_single_precision() {
        for coordinate in [1.0f32, 3.5, 1023.9, 1024.0, 448_000.0, 5_411_000.0] {
            let next = f32::from_bits(coordinate.to_bits() + 1);
            assert_eq!(step_at(coordinate.into()), f64::from(next) - f64::from(coordinate), "{coordinate}");
        }
    }
}
