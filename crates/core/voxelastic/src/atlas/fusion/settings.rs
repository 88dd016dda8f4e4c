//! Limits that fused voxels keep.

use crate::field::occupancy::steps;
use crate::field::tsdf::WEIGHT_ONE;

/// Limits of the voxels of a fused submap: those of integration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionSettings {
    /// Largest weight of a TSDF voxel, observations.
    pub max_weight: f32,
    /// Least log-odds of an occupancy voxel.
    pub min_log_odds: f32,
    /// Largest log-odds of an occupancy voxel.
    pub max_log_odds: f32,
}

impl FusionSettings {
    /// Least and largest value of an occupancy voxel, steps.
    pub(crate) fn log_odds_limits(&self) -> [i8; 2] {
        [steps(self.min_log_odds), steps(self.max_log_odds)]
    }

    /// Largest weight as it is stored.
    pub(super) fn weight_cap(&self) -> u16 {
        (self.max_weight * f32::from(WEIGHT_ONE)).clamp(1.0, f32::from(u16::MAX)) as u16
    }
}
