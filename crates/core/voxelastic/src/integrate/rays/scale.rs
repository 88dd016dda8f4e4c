//! The integration scale (paper Sec. III-A): the largest voxel that fits a beam's cone at the measured range.

use crate::octree::SCALES;

/// Chooses the scale at which a block is integrated, from its distance to the sensor.
///
/// The cone's opening is the smallest angle between adjacent beams. A voxel of scale s, 2^s finest voxels wide, fits where its space diagonal is at most the
/// width of the cone. Hysteresis keeps a block at the limit of two scales from changing with every scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaleRule {
    /// Distances from which scales 1, 2 and 3 fit the cone, metres.
    starts: [f32; SCALES - 1],
    /// A block becomes finer only when it is nearer than the start of its scale by this much, metres.
    finer_margin: f32,
    /// A block becomes coarser only beyond the start of the next scale times this.
    hysteresis: f32,
    /// Width of the cone at a distance of one metre.
    width_per_metre: f32,
}

impl ScaleRule {
    /// The rule for beams `smallest_angle` radians apart and finest voxels of `voxel` metres. `max_scale` is the coarsest scale (0 for a single resolution).
    /// A block keeps a finer scale than fits up to `hysteresis` (at least 1) times the distance at which the next scale starts.
    pub fn new(smallest_angle: f32, voxel: f32, max_scale: usize, hysteresis: f32) -> Self {
        let width_per_metre = 2.0 * (0.5 * smallest_angle).tan();
        let starts = std::array::from_fn(|i| {
            let edge = voxel * (2 << i) as f32;
            if i + 1 > max_scale { f32::INFINITY } else { 3f32.sqrt() * edge / width_per_metre }
        });
        Self { starts, finer_margin: 4.0 * voxel, hysteresis: hysteresis.max(1.0), width_per_metre }
    }

    /// The scale that fits between returns that are `spacing` metres apart, with points between them.
    #[inline(always)]
    pub fn fitting_between(&self, spacing: f32) -> usize {
        /// With points between the returns, voxels may be so much smaller; with more of them, nothing is gained (docs/experiments/scans/scattered-clouds.md).
        const FINER: f32 = 4.0;
        self.fitting(spacing / (FINER * self.width_per_metre))
    }

    /// The least distance at which `scale` fits, metres.
    pub fn start(&self, scale: usize) -> f32 {
        scale.checked_sub(1).and_then(|i| self.starts.get(i)).copied().unwrap_or(0.0)
    }

    /// The scale that fits at `distance` metres.
    #[inline(always)]
    pub fn fitting(&self, distance: f32) -> usize {
        self.starts.iter().map(|&start| usize::from(distance >= start)).sum()
    }

    /// The scale at which to integrate a block that is at scale `current` and whose centre is at `distance` metres: at most one step away from `current`.
    #[inline]
    pub fn next(&self, current: usize, distance: f32) -> usize {
        if current > 0 && distance < self.starts[current - 1] - self.finer_margin {
            current - 1
        } else if current < SCALES - 1 && distance > self.starts[current] * self.hysteresis + self.finer_margin {
            current + 1
        } else {
            current
        }
    }
}

/// Distance from `sensor` to the centre of the block at `coords`, in the unit of `sensor` and of the blocks' `edge`.
#[inline(always)]
pub(crate) fn distance_to_block(coords: [i32; 3], edge: f32, sensor: [f32; 3]) -> f32 {
    (0..3).map(|k| ((coords[k] as f32 + 0.5) * edge - sensor[k]).powi(2)).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_voxel_fits_the_cone_and_the_next_larger_one_does_not() {
        let (angle, voxel) = (0.3516f32.to_radians(), 0.065);
        let rule = ScaleRule::new(angle, voxel, 3, 1.0);
        for i in 1..1200 {
            let distance = i as f32 * 0.1;
            let cone = 2.0 * distance * (0.5 * angle).tan();
            let scale = rule.fitting(distance);
            let diagonal = |s: usize| 3f32.sqrt() * voxel * (1 << s) as f32;
            assert!(scale == 0 || diagonal(scale) <= cone * 1.0001);
            assert!(scale == 3 || diagonal(scale + 1) >= cone * 0.9999);
        }
    }

    #[test]
    fn jitter_at_the_limit_of_two_scales_does_not_change_the_scale() {
        let rule = ScaleRule::new(0.006, 0.065, 3, 1.2);
        let start = (1..).map(|i| i as f32 * 0.01).find(|&d| rule.fitting(d) == 1).unwrap_or_default();
        for jitter in [-0.1f32, 0.1] {
            assert_eq!(rule.next(0, start + jitter), 0);
            assert_eq!(rule.next(1, start + jitter), 1);
        }
        assert_eq!(rule.next(1, start * 0.5), 0);
        assert_eq!(rule.next(0, start * 1.5), 1);
        assert_eq!(rule.next(0, 1e6), 1, "one step at a time");
    }
}
