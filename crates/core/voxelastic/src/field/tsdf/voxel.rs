//! One TSDF voxel: 4 bytes.
//!
//! A voxel's distance is in voxels *of its own scale*: the truncation band is equally many voxels wide at every scale, so in metres
//! it grows with the scale, on both sides of the surface. Distances are positive in front of the surface.

use bytemuck::{Pod, Zeroable};

/// Steps of [`Voxel::distance`] per voxel edge.
pub const DISTANCE_STEPS: f32 = 2048.0;
/// Weight of one full observation.
pub const WEIGHT_ONE: u16 = 16;

/// One voxel of a TSDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Voxel {
    /// Signed distance from the voxel's centre to the surface, in 1 / [`DISTANCE_STEPS`] of this voxel's edge.
    pub distance: i16,
    /// Sum of the weights of the observations, in 1 / [`WEIGHT_ONE`]; 0 means unobserved.
    pub weight: u16,
}

impl Voxel {
    /// Whether any beam was integrated into it.
    #[inline(always)]
    pub fn is_observed(self) -> bool {
        self.weight != 0
    }

    /// Signed distance in edges of this voxel.
    #[inline(always)]
    pub fn distance_in_voxels(self) -> f32 {
        f32::from(self.distance) / DISTANCE_STEPS
    }

    /// Updates distance and weight with one observation: the weighted mean, and the sum of the weights up to `max_weight` (paper Sec. III-A).
    /// Both are rounded to whole steps. An observation of weight zero changes nothing; smaller sums than one step count as one.
    #[inline(always)]
    pub fn observe(&mut self, distance_steps: f32, weight: f32, max_weight: f32) {
        let sum = f32::from(self.weight) + weight;
        let distance = f32::from(self.distance);
        self.distance = low_bits(distance + (distance_steps - distance) * (weight / if sum > 1.0 { sum } else { 1.0 })) as i16;
        // Not `min`, which would also handle NaN.
        self.weight = low_bits(if sum < max_weight { sum } else { max_weight });
    }
}

/// The low 16 bits of `x` rounded to nearest, ties to even, for |x| < 2^22: adding the constant leaves no fraction bits in the mantissa.
/// A cast would saturate and handle NaN, at several times the cost.
#[inline(always)]
fn low_bits(x: f32) -> u16 {
    const MAGIC: f32 = 12_582_912.0; // 1.5 * 2^23
    (x + MAGIC).to_bits() as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observations_average_and_the_weight_is_capped() {
        let mut voxel = Voxel::default();
        for i in 0..200 {
            voxel.observe(if i % 2 == 0 { 1000.0 } else { 1200.0 }, f32::from(WEIGHT_ONE), 100.0 * f32::from(WEIGHT_ONE));
        }
        assert!((i32::from(voxel.distance) - 1100).abs() < 30, "{voxel:?}");
        assert_eq!(voxel.weight, 100 * WEIGHT_ONE);
    }
}
