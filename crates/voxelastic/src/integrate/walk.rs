//! The update kernel: walk one beam through the voxels of one block.

use super::transform::Beam;
use crate::field::tsdf::{DISTANCE_STEPS, Voxel};
use crate::octree::BLOCK_EDGE;

/// What a beam does to the voxels near its point.
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
        self.weight * fade.min(1.0)
    }
}

/// Walks every beam through a block at `SCALE` whose smallest corner is at `corner` (finest voxels, submap frame).
///
/// A voxel that the beam's line passes through within the band sees the distance from its centre to the local plane at
/// the beam's point, not the distance along the beam: the centre is rarely on the line.
#[inline(always)]
pub(crate) fn walk_block<'a, const SCALE: usize>(
    voxels: &mut [Voxel],
    mut shades: Option<&mut [u8]>,
    corner: [f32; 3],
    beams: impl Iterator<Item = &'a Beam>,
    band: &Band,
) {
    let edge = (BLOCK_EDGE >> SCALE) as i32;
    let shift = 3 - SCALE;
    let per_voxel = 1.0 / (1 << SCALE) as f32;
    let size = edge as f32;
    for beam in beams {
        let point: [f32; 3] = std::array::from_fn(|k| (beam.point[k] - corner[k]) * per_voxel);
        // Parameters along the beam, zero at the point, between which the line is inside both block and band.
        let (mut enter, mut leave) = (-band.truncation, band.truncation);
        let mut inverse = [0f32; 3];
        for k in 0..3 {
            let d = beam.direction[k];
            inverse[k] = 1.0 / if d.abs() < 1e-9 { 1e-9f32.copysign(d) } else { d };
            let (a, b) = (-point[k] * inverse[k], (size - point[k]) * inverse[k]);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
        if enter >= leave {
            continue;
        }
        let mut cell = [0i32; 3];
        let mut step = [0i32; 3];
        let mut next = [0f32; 3];
        let mut distance = 0.0;
        for k in 0..3 {
            let at = point[k] + enter * beam.direction[k];
            cell[k] = (at as i32).clamp(0, edge - 1);
            let ahead = beam.direction[k] > 0.0;
            step[k] = if ahead { 1 } else { -1 };
            next[k] = ((cell[k] + i32::from(ahead)) as f32 - point[k]) * inverse[k];
            distance += beam.normal[k] * (cell[k] as f32 + 0.5 - point[k]);
        }
        let crossing = inverse.map(f32::abs);
        let slope: [f32; 3] = std::array::from_fn(|k| beam.normal[k] * step[k] as f32);
        loop {
            if distance.abs() < band.truncation {
                let index = (cell[0] | cell[1] << shift | cell[2] << (2 * shift)) as usize;
                let weight = band.weight_at(distance);
                if weight >= 1.0 {
                    if let Some(shades) = &mut shades {
                        observe_shade(&mut shades[index], beam.shade, voxels[index].weight == 0);
                    }
                    voxels[index].observe(distance * DISTANCE_STEPS, weight, band.max_weight);
                }
            }
            let axis = if next[0] <= next[1] && next[0] <= next[2] {
                0
            } else if next[1] <= next[2] {
                1
            } else {
                2
            };
            if next[axis] >= leave {
                break;
            }
            cell[axis] += step[axis];
            if cell[axis] as u32 >= edge as u32 {
                break;
            }
            next[axis] += crossing[axis];
            distance += slope[axis];
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
