//! The truncation band: which voxels a ray updates, with which distance and weight.
#![allow(clippy::needless_range_loop)] // Lanes index many arrays at once.

use crate::field::tsdf::brick::brick_address;
use crate::field::tsdf::propagate::{INTERPOLATED_WEIGHT, Interpolation};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel};
use crate::integrate::rays::dda::{LANES, MAX_STEPS, Traversal};

/// The truncation band and the weights of a TSDF update.
#[derive(Clone, Copy, Debug)]
pub(super) struct TruncationBand {
    /// How far the band reaches in front of the surface, voxels of the block's scale.
    pub front: f32,
    /// How far in front of the surface voxels are created; farther ones are updated only if they exist.
    pub create_front: f32,
    /// How far the band reaches behind the surface.
    pub back: f32,
    /// Part of its weight that an observation loses for each voxel farther behind the surface.
    pub fade: f32,
    /// Weight of an observation in front of the surface.
    pub weight: f32,
    /// Largest weight of a voxel.
    pub max_weight: f32,
}

impl TruncationBand {
    /// Weight of an observation at `distance` voxels: full down to one voxel behind the surface, then falling to zero at the end of the band, because nothing is
    /// measured behind a surface (Bylow et al., RSS 2013).
    #[inline(always)]
    pub fn weight_at(&self, distance: f32) -> f32 {
        let fade = (self.back + distance) * self.fade;
        self.weight * if fade < 1.0 { fade } else { 1.0 }
    }

    /// Collects the updates of the voxels that segments pass within the band, segment by segment.
    ///
    /// A voxel is updated with the distance from its centre to the local plane at the ray's point, not with the distance along the ray: the centre is rarely on
    /// the ray.
    ///
    /// The number of voxels of a segment is unpredictable, so the loops run over steps and lanes and do not branch on whether a voxel is within the band:
    /// updates outside of it are written to an entry that is never read.
    #[inline(always)]
    pub fn collect(&self, traversal: &Traversal, labels: &LaneLabels, updates: &mut VoxelUpdates) {
        let (mut counts, mut is_update) = ([0u32; LANES], [[0u32; LANES]; MAX_STEPS]);
        for (step, is_update) in is_update.iter_mut().enumerate().take(traversal.longest) {
            for lane in 0..LANES {
                is_update[lane] = self.is_update(traversal, step, lane);
                counts[lane] += is_update[lane];
            }
        }
        let mut next = [0u32; LANES];
        for lane in 1..LANES {
            next[lane] = next[lane - 1] + counts[lane - 1];
        }
        updates.len = (next[LANES - 1] + counts[LANES - 1]) as usize;
        for (step, is_update) in is_update.iter().enumerate().take(traversal.longest) {
            let (mut to, mut update) = ([0u32; LANES], [0u64; LANES]);
            for lane in 0..LANES {
                to[lane] = if is_update[lane] == 1 { next[lane] } else { VoxelUpdates::MAX_LEN as u32 };
                next[lane] += is_update[lane];
                let target = labels.label[lane] | brick_address(labels.fine[lane], traversal.index[step][lane]);
                update[lane] = u64::from(target) | u64::from(traversal.quantity[step][lane].to_bits()) << 32;
            }
            for lane in 0..LANES {
                updates.all[to[lane] as usize % UPDATE_CAPACITY] = VoxelUpdate(update[lane]);
            }
        }
    }

    /// 1 if the segment in `lane` updates the voxel that it passes in `step`, else 0.
    #[inline(always)]
    fn is_update(&self, traversal: &Traversal, step: usize, lane: usize) -> u32 {
        let d = traversal.quantity[step][lane];
        let is_alive = (step as u32) < traversal.steps[lane];
        u32::from(is_alive & (d < self.front) & (d > -self.back) & (self.weight_at(d) >= 1.0))
    }

    /// Whether an observation at `distance` voxels creates its voxel if that does not exist.
    #[inline(always)]
    pub fn creates_voxel(&self, distance: f32) -> bool {
        distance < self.create_front
    }

    /// How finer voxels without measurements are interpolated.
    pub fn interpolation(&self) -> Interpolation {
        Interpolation { weight: INTERPOLATED_WEIGHT, band: [-self.back, self.create_front].map(|voxels| (voxels * DISTANCE_STEPS) as i16) }
    }

    /// Folds an observation at `distance` voxels into its voxel.
    #[inline(always)]
    pub fn observe(&self, distance: f32, weight: f32, voxel: &mut Voxel) {
        // By a mask: which voxels exist is unpredictable.
        let is_updated = u32::from(voxel.is_observed() | self.creates_voxel(distance));
        let weight = f32::from_bits(weight.to_bits() & is_updated.wrapping_neg());
        voxel.observe(distance * DISTANCE_STEPS, weight, self.max_weight);
    }
}

/// What the updates of each lane have in common.
#[derive(Clone, Debug)]
pub(super) struct LaneLabels {
    /// All bits set for a segment through a block at scale 0, none for others.
    pub fine: [u32; LANES],
    /// Bits above those of a [`brick_address`], chosen by the caller.
    pub label: [u32; LANES],
}

/// The updates of the voxels of a batch of segments, see [`TruncationBand::collect`].
#[derive(Clone, Debug)]
pub(super) struct VoxelUpdates {
    /// The first `len` are valid, segment by segment.
    pub all: [VoxelUpdate; UPDATE_CAPACITY],
    pub len: usize,
}

/// One update of a voxel, packed into a word so that one store writes it: the target in the lower half, the bits of the distance in the upper.
#[derive(Clone, Copy, Debug)]
pub(super) struct VoxelUpdate(u64);

impl VoxelUpdate {
    /// The voxel's [`brick_address`] among the bricks of its block, and above that the label of the segment's lane.
    #[inline(always)]
    pub fn target(self) -> u32 {
        self.0 as u32
    }

    /// Distance from the voxel's centre to the plane, voxels.
    #[inline(always)]
    pub fn distance(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// Room for all updates and the entry that is never read; a power of two, so that no index needs a bounds check.
pub(super) const UPDATE_CAPACITY: usize = (VoxelUpdates::MAX_LEN + 1).next_power_of_two();

impl VoxelUpdates {
    /// Most voxels that a batch of segments passes.
    const MAX_LEN: usize = LANES * MAX_STEPS;

    pub fn new() -> Self {
        Self { all: [VoxelUpdate(0); UPDATE_CAPACITY], len: 0 }
    }
}

/// Whether a voxel `distance` voxels from the surface has an intensity.
#[inline(always)]
pub(super) fn has_intensity_at(distance: f32) -> bool {
    distance.abs() < INTENSITY_BAND
}

/// How far from the surface voxels have an intensity, in voxels: a vertex takes that of the nearest voxel.
const INTENSITY_BAND: f32 = 1.5;

/// Moves an intensity an eighth of the way to the observed one, by at least one; 0 is unknown and takes the observed one.
#[inline(always)]
pub(super) fn observe_intensity(intensity: &mut u8, observed: u8) {
    let (old, observed) = (i32::from(*intensity), i32::from(observed));
    let change = observed - old;
    // The shift rounds down, which is away from zero for negative changes; 7 is added to positive ones to round them up.
    let moved = old + ((change + if change > 0 { 7 } else { 0 }) >> 3);
    *intensity = (if old == 0 { observed } else { moved }) as u8;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intensities_converge_to_the_observed_one() {
        for (first, then) in [(1, 255), (255, 1), (100, 101), (101, 100), (7, 7)] {
            let mut intensity = 0;
            observe_intensity(&mut intensity, first);
            assert_eq!(intensity, first);
            let mut front = intensity;
            for _ in 0..60 {
                observe_intensity(&mut intensity, then);
                assert!(intensity.abs_diff(then) < front.abs_diff(then) || intensity == then);
                front = intensity;
            }
            assert_eq!(intensity, then);
        }
    }
}
