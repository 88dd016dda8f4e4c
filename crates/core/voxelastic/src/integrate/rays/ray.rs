//! One ray in the frame and unit in which it is walked: submap frame, finest voxels.

use crate::octree::BLOCK_EDGE;

/// One ray. Lengths count finest voxels; the frame is the submap's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub(crate) struct Ray {
    /// The measured point.
    pub point: [f32; 3],
    /// Integration scale at its range.
    pub scale: u32,
    /// Unit vector along which it is walked: from the sensor to the point, or steeper towards its plane (see [`super::transform`]).
    pub direction: [f32; 3],
    /// Intensity of the return.
    pub intensity: u8,
    /// Number of returns that were bundled into this ray (see [`super::ray_bundling`]).
    pub count: u8,
    /// Whether the local plane is known.
    pub has_plane: bool,
    /// Normal of the local plane, facing the sensor; opposite to the measured direction where no plane is known.
    pub normal: [f32; 3],
    /// Distance from the sensor to the point.
    pub range: f32,
    /// How far the ray is walked in front of its point and behind it, voxels of the scale of the block that it passes.
    pub reach: [f32; 2],
}

impl Ray {
    /// Whether the ray can meet a voxel less than `front` voxels in front of its plane, in the block with smallest corner `corner` (finest voxels) and
    /// voxels of 2^`scale` finest ones.
    pub fn creates_voxels_in(&self, corner: [f32; 3], scale: u8, front: f32) -> bool {
        /// A ray can pass a voxel whose centre is nearer to the plane than the ray itself by this many of the voxel's edges (half its diagonal).
        const HALF_DIAGONAL: f32 = 0.87;
        let voxel = f32::from(1u8 << scale);
        let slope = -(0..3).map(|k| self.direction[k] * self.normal[k]).sum::<f32>();
        let (mut enter, mut leave) = (-self.reach[0].min((front + HALF_DIAGONAL) / slope.max(1e-3)) * voxel, self.reach[1] * voxel);
        for (k, low) in corner.into_iter().enumerate() {
            let inverse = 1.0 / self.direction[k];
            let [a, b] = [low, low + BLOCK_EDGE as f32].map(|face| (face - self.point[k]) * inverse);
            // NaN where the ray lies in a face; `max` and `min` then keep the other operand.
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        enter <= leave + 1e-3
    }
}
