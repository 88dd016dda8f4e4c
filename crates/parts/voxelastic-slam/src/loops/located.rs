//! Where a scan may have been taken, and how probable that is.

use nalgebra::Matrix6;
use voxelastic::geometry::{Pose, PoseExt};

/// Another place whose quality is at least this share of the best's fits as well.
const AS_GOOD: f64 = 0.97;
/// Probability of a place that is certain.
const CERTAIN: f64 = 0.99;

/// A place at which a scan may have been taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Pose of the lidar in the map frame.
    pub t_map_lidar: Pose,
    /// How probable it is that the scan was taken here, 0 to 1. What is left of all places is the probability of none of them: that the place was not mapped, or was missed.
    pub probability: f64,
    /// Whether overlap and contradiction are within their limits.
    pub is_possible: bool,
    /// Whether it is possible, probable (0.99), and no other place fits as well.
    pub is_certain: bool,
    /// Share of the scan's surfaces with a counterpart in the map.
    pub overlap: f64,
    /// Mean weight of the scan's surfaces, 1 where all lie on the map's.
    pub score: f64,
    /// Share of the surfaces of the map in space that the scan saw to be free, or of the scan in such space of the map: the larger one.
    pub contradiction: f64,
    /// temporary
    pub fine: f64,
    /// temporary
    pub circle: f64,
    /// Share of the scan's surfaces beside those of the map, where the map has any near.
    pub beside: f64,
    /// Robust mean distance of the scan's surfaces to those of the map, metres.
    pub spread: f64,
    /// Information of the pose in the lidar frame (x y z roll pitch yaw), inverse square metres and radians, of a pose that was refined.
    pub information: Option<Matrix6<f64>>,
}

impl Located {
    fn quality(&self) -> f64 {
        self.score * (1.0 - 4.0 * self.contradiction)
    }

    /// How much more probable this place is than none.
    fn odds(&self) -> f64 {
        1.0
    }
}

/// The best of each place, the best first, with their probabilities. Poses are the same that are no farther apart than `same`, metres and radians.
pub(super) fn judged(mut found: Vec<Located>, same: (f64, f64)) -> Vec<Located> {
    found.sort_by(|a, b| b.quality().total_cmp(&a.quality()));
    let mut distinct: Vec<Located> = Vec::new();
    for located in found {
        if !distinct.iter().any(|better| is_near(&better.t_map_lidar, &located.t_map_lidar, same)) {
            distinct.push(located);
        }
    }
    let Some(best) = distinct.first().copied() else { return distinct };
    // What a map makes of noise must not decide between places that fit as well.
    let fits_as_well = |other: &Located| other.is_possible && other.quality() >= AS_GOOD * best.quality();
    let odds: Vec<f64> = distinct.iter().map(|l| if fits_as_well(l) { l.odds().max(best.odds()) } else { l.odds() }).collect();
    let sum = 1.0 + odds.iter().sum::<f64>();
    let has_rival = distinct[1..].iter().any(fits_as_well);
    for (k, (located, odds)) in distinct.iter_mut().zip(odds).enumerate() {
        located.probability = odds / sum;
        located.is_certain = k == 0 && located.is_possible && !has_rival && located.probability >= CERTAIN;
    }
    distinct
}

pub(super) fn is_near(a: &Pose, b: &Pose, within: (f64, f64)) -> bool {
    a.translation_distance(b) < within.0 && a.rotation_distance(b) < within.1
}
