//! What a beam tells the voxels of its truncation band.
#![allow(clippy::needless_range_loop)] // A lane is an index into many arrays here.

use super::walk::{LANES, MAX_STEPS, Trace};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel};

/// The truncation band and the weights of a TSDF update.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Band {
    /// Half width of the band, in voxels of the block's scale.
    pub truncation: f32,
    /// Weight of an observation in front of the surface.
    pub weight: f32,
    /// Cap of a voxel's weight.
    pub max_weight: f32,
}

impl Band {
    /// Weight of an observation at `distance` voxels: full down to one voxel behind the surface, then falling to zero at
    /// the end of the band, because what lies behind a surface is a guess (Bylow et al., RSS 2013).
    #[inline(always)]
    fn weight_at(&self, distance: f32) -> f32 {
        let fade = (self.truncation + distance) / (self.truncation - 1.0).max(0.5);
        self.weight * if fade < 1.0 { fade } else { 1.0 }
    }

    /// What lines tell the voxels that they pass: distances in steps of [`Voxel::distance`], and weights, 0 for nothing.
    #[inline(always)]
    pub fn observations(&self, trace: &Trace, observations: &mut Observations) {
        for step in 0..trace.longest {
            let (quantity, distance, weight) = (&trace.quantity[step], &mut observations.distance[step], &mut observations.weight[step]);
            let is_near = &mut observations.is_near[step];
            for lane in 0..LANES {
                let d = quantity[lane];
                let w = self.weight_at(d);
                distance[lane] = d * DISTANCE_STEPS;
                weight[lane] = if d.abs() < self.truncation && w >= 1.0 { w } else { 0.0 };
                is_near[lane] = d.abs() < SHADED;
            }
        }
    }

    /// Folds what the line of `lane` says into its block's voxels.
    ///
    /// A voxel that the beam's line passes through within the band sees the distance from its centre to the local plane
    /// at the beam's point, not the distance along the beam: the centre is rarely on the line.
    #[inline(always)]
    pub fn apply(&self, trace: &Trace, observations: &Observations, lane: usize, voxels: &mut [Voxel], shades: Option<&mut [u8]>, shade: u8) {
        let steps = trace.steps[lane] as usize;
        if let Some(shades) = shades {
            for step in 0..steps {
                if observations.is_near[step][lane] {
                    observe_shade(&mut shades[trace.index[step][lane] as usize], shade);
                }
            }
        }
        for step in 0..steps {
            let weight = observations.weight[step][lane];
            if weight > 0.0 {
                voxels[trace.index[step][lane] as usize].observe(observations.distance[step][lane], weight, self.max_weight);
            }
        }
    }
}

/// See [`Band::observations`].
#[derive(Clone, Debug)]
pub(crate) struct Observations {
    distance: [[f32; LANES]; MAX_STEPS],
    weight: [[f32; LANES]; MAX_STEPS],
    /// Whether the voxel is so near to the surface that it takes part in showing it.
    is_near: [[bool; LANES]; MAX_STEPS],
}

impl Observations {
    pub fn new() -> Self {
        Self { distance: [[0.0; LANES]; MAX_STEPS], weight: [[0.0; LANES]; MAX_STEPS], is_near: [[false; LANES]; MAX_STEPS] }
    }
}

/// How far from the surface voxels have an intensity, in voxels: a vertex has that of the voxel beside it.
const SHADED: f32 = 1.5;

/// Moves a voxel's intensity, 0 while it is unknown, an eighth of the way to the observed one, and at least by one.
#[inline(always)]
fn observe_shade(shade: &mut u8, observed: u8) {
    let (old, observed) = (i32::from(*shade), i32::from(observed));
    let change = observed - old;
    // Shifting rounds downwards: away from zero where it is negative, and where it is positive with what is added.
    let towards = old + ((change + if change > 0 { 7 } else { 0 }) >> 3);
    *shade = if old == 0 { observed } else { towards } as u8;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intensities_come_to_what_is_observed() {
        for (first, then) in [(1, 255), (255, 1), (100, 101), (101, 100), (7, 7)] {
            let mut shade = 0;
            observe_shade(&mut shade, first);
            assert_eq!(shade, first);
            let mut before = shade;
            for _ in 0..60 {
                observe_shade(&mut shade, then);
                assert!(shade.abs_diff(then) < before.abs_diff(then) || shade == then);
                before = shade;
            }
            assert_eq!(shade, then);
        }
    }
}
