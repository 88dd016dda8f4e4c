//! The inverse sensor model: log-odds as a piecewise linear function of the distance to the return.

use super::settings::OccupancySettings;
use crate::field::occupancy::steps;
use crate::simd::{larger, smaller};

/// Least sigma of the ramp, in local voxels: a voxel whose centre is half an edge before the return, which may contain it, is just occupied, and the next one
/// towards the sensor is free.
pub(super) const LEAST_SIGMA: f32 = 0.25;

/// The model at one range and scale: evidence as a function of the distance behind the return.
///
/// ```text
///   hit            ________
///                 /        \
///   0            /          \___
///          _____/
///   free        |-3s -s  t/2  t   distance behind the return
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Evidence {
    free: f32,
    hit: f32,
    /// Voxels of the scale.
    sigma: f32,
    thickness: f32,
}

impl Evidence {
    /// The model for a return at `range` metres, in voxels of `scale`.
    #[inline(always)]
    pub fn new(settings: &OccupancySettings, range: f32, scale: usize) -> Self {
        let local = settings.voxel_size * (1 << scale) as f32;
        let sigma = (settings.sigma + settings.sigma_per_metre * range).max(LEAST_SIGMA * local) / local;
        Self { free: settings.free, hit: settings.hit, sigma, thickness: settings.thickness_voxels }
    }

    /// The noise at the return, voxels of the scale; the only parameter that depends on the return.
    #[inline(always)]
    pub fn sigma(&self) -> f32 {
        self.sigma
    }

    /// The model for a return with another noise.
    #[inline(always)]
    pub fn with_sigma(self, sigma: f32) -> Self {
        Self { sigma, ..self }
    }

    /// The distances behind the return between which a ray is walked: before the first the evidence is `free`, behind the second there is none.
    #[inline(always)]
    pub fn reach(&self) -> (f32, f32) {
        (-3.0 * self.sigma, self.thickness)
    }

    /// Evidence at `distance` local voxels behind the return.
    #[inline(always)]
    pub fn at(&self, distance: f32) -> f32 {
        let rise = (distance + 3.0 * self.sigma) / (2.0 * self.sigma);
        let fall = (self.thickness - distance) / (0.5 * self.thickness);
        let front = self.free + (self.hit - self.free) * clamp01(rise);
        smaller(front, self.hit * clamp01(fall))
    }
}

/// `x` limited to 0..=1.
#[inline(always)]
fn clamp01(x: f32) -> f32 {
    smaller(larger(x, 0.0), 1.0)
}

/// How far before a return a voxel must be to count as free, metres: at least the first value, and at least `second[0] + second[1] * range`. Nearer voxels are
/// updated by the rays.
pub(super) fn free_margin_terms(settings: &OccupancySettings) -> (f32, [f32; 2]) {
    (3.0 * LEAST_SIGMA * settings.voxel_size, [3.0 * settings.sigma, 3.0 * settings.sigma_per_metre])
}

/// The evidence of free space and the limits, in log-odds steps of the field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steps {
    pub free: i8,
    pub min: i8,
    pub max: i8,
}

impl Steps {
    pub fn new(settings: &OccupancySettings) -> Self {
        Self { free: steps(settings.free).min(-1), min: steps(settings.min), max: steps(settings.max) }
    }

    /// `value` after evidence of `update` steps, within the limits.
    #[inline(always)]
    pub fn add(&self, value: i8, update: i8) -> i8 {
        let before = if value == crate::field::occupancy::UNKNOWN { 0 } else { i16::from(value) };
        (before + i16::from(update)).clamp(i16::from(self.min), i16::from(self.max)) as i8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_is_free_before_hit_at_and_nothing_behind_the_return() {
        let settings = OccupancySettings::default();
        for scale in 0..4 {
            for range in [1.0, 20.0, 60.0] {
                let e = Evidence::new(&settings, range, scale);
                let (before, behind) = e.reach();
                assert!((e.at(before) - settings.free).abs() < 1e-6);
                assert!(e.at(-0.5) > 0.0 && (e.at(-1.0) < 0.0 || e.sigma > LEAST_SIGMA));
                assert!((e.at(0.0) - settings.hit).abs() < 1e-6);
                assert!(e.at(behind).abs() < 1e-6);
                let mut last = e.at(before);
                for i in 1..100 {
                    let d = before + (behind - before) * i as f32 / 100.0;
                    let here = e.at(d);
                    assert!((here - last).abs() < 0.2, "continuous");
                    last = here;
                }
            }
        }
    }
}
