//! Settings of TSDF integration.

use crate::octree::SCALES;

/// How scans update a TSDF.
#[derive(Clone, Debug, PartialEq)]
pub struct TsdfSettings {
    /// Edge of the finest voxel, metres.
    pub voxel_size: f32,
    /// Largest range that is integrated, metres.
    pub max_range: f32,
    /// How far the truncation band reaches along a ray, before its point and beyond, voxels of the integration scale, 1 to 8.
    pub truncation_voxels: f32,
    /// How far in front of the surface voxels are created, perpendicular to it, in the same voxels, 1.5 to 8. Up to half a voxel farther, existing voxels are
    /// updated too, which erodes what a ray passed through; a mesh needs no voxels there, so none are created.
    pub truncation_front: f32,
    /// How far the band reaches behind the surface, perpendicular to it, in the same voxels, 1 to 8. Nothing is measured there, and a thick band would
    /// interfere with other surfaces behind.
    pub truncation_behind: f32,
    /// Largest width of a bundle of rays that are walked as one, voxels of the integration scale; 0 to walk each alone. Rays half a voxel apart pass nearly the
    /// same voxels.
    pub bundle_width: f32,
    /// Observations after which a voxel's mean becomes a moving average.
    pub max_weight: f32,
    /// Coarsest integration scale, 0 to 3.
    pub max_scale: usize,
    /// Hysteresis: how many times farther than the next scale's start a block keeps the finer scale that it has.
    pub scale_hysteresis: f32,
}

impl Default for TsdfSettings {
    fn default() -> Self {
        Self {
            voxel_size: 0.065,
            max_range: 60.0,
            truncation_voxels: 3.0,
            truncation_front: 1.5,
            truncation_behind: 1.5,
            bundle_width: 0.6,
            max_weight: 100.0,
            max_scale: SCALES - 1,
            scale_hysteresis: 1.5,
        }
    }
}
