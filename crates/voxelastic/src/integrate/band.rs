//! What a beam tells the voxels of its truncation band.

use super::transform::Beam;
use super::walk::{Line, local, walk_line};
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

    /// Updates a block at `SCALE` whose smallest corner is at `corner` (finest voxels, submap frame) from each beam.
    ///
    /// A voxel that the beam's line passes through within the band sees the distance from its centre to the local plane
    /// at the beam's point, not the distance along the beam: the centre is rarely on the line.
    #[inline(always)]
    pub fn apply<'a, const SCALE: usize>(
        &self,
        voxels: &mut [Voxel],
        mut shades: Option<&mut [u8]>,
        corner: [f32; 3],
        beams: impl Iterator<Item = &'a Beam>,
    ) {
        for beam in beams {
            let line = Line { point: local::<SCALE>(beam.point, corner), direction: beam.direction, gradient: beam.normal };
            walk_line::<SCALE>(&line, -self.truncation, self.truncation, |index, distance| {
                let weight = self.weight_at(distance);
                if distance.abs() < self.truncation && weight >= 1.0 {
                    if let Some(shades) = &mut shades {
                        observe_shade(&mut shades[index], beam.shade, voxels[index].weight == 0);
                    }
                    voxels[index].observe(distance * DISTANCE_STEPS, weight, self.max_weight);
                }
            });
        }
    }
}

/// Moves a voxel's intensity an eighth of the way to the observed one, and at least by one.
#[inline(always)]
fn observe_shade(shade: &mut u8, observed: f32, first: bool) {
    let old = f32::from(*shade);
    let change = (observed - old) / 8.0;
    *shade = if first { observed } else { old + change + 0.5f32.copysign(change) } as u8;
}
