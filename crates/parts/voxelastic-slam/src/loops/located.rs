//! Where a scan may have been taken, and how probable that is.

use nalgebra::Matrix6;
use voxelastic::geometry::{Pose, PoseExt};

/// How much the logarithm of a place's weight among the others falls with its fine contradiction, and with what lies beside. Fitted to places that look alike, simulated and recorded
/// (`docs/experiments/elastic/look-alikes.md`).
const AMONG: [f64; 2] = [320.0, 320.0];
/// Another place whose quality is at least this share of the best's fits as well.
const AS_GOOD: f64 = 0.97;
/// Probability of a place that is certain.
const CERTAIN: f64 = 0.99;

/// A place at which a scan may have been taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Pose of the lidar in the map frame.
    pub t_map_lidar: Pose,
    /// How probable it is that the scan was taken here, 0 to 1, if it was taken at one of the possible places: whether it was, their overlap and contradiction say.
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
    /// The same in voxels of half the size, in which thin furniture is no part of the wall that it stands at.
    pub fine_contradiction: f64,
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

    /// What speaks against the place: contradiction and what lies beside, each weighed.
    fn doubt(&self) -> f64 {
        AMONG[0] * self.fine_contradiction + AMONG[1] * self.beside
    }
}

/// The best of each place, the best first, with their probabilities. Poses are the same that are no farther apart than `same`, metres and radians.
pub(super) fn judged(mut found: Vec<Located>, same: (f64, f64)) -> Vec<Located> {
    found.sort_by(|a, b| b.is_possible.cmp(&a.is_possible).then(b.quality().total_cmp(&a.quality())));
    let mut distinct: Vec<Located> = Vec::new();
    for located in found {
        if !distinct.iter().any(|better| is_near(&better.t_map_lidar, &located.t_map_lidar, same)) {
            distinct.push(located);
        }
    }
    let possible = |l: &&Located| l.is_possible;
    // What a map makes of noise must not decide between places that fit as well.
    let doubt = distinct.iter().filter(possible).map(Located::doubt).fold(f64::INFINITY, f64::min);
    let quality = distinct.iter().filter(possible).filter(|l| l.doubt() <= doubt).map(Located::quality).fold(0.0, f64::max);
    let fits_as_well = |l: &Located| l.is_possible && l.quality() >= AS_GOOD * quality;
    let weights: Vec<f64> =
        distinct.iter().map(|l| if fits_as_well(l) { 1.0 } else { f64::from(u8::from(l.is_possible)) * (doubt - l.doubt()).exp() }).collect();
    let sum: f64 = weights.iter().sum();
    let has_rival = distinct.iter().filter(|l| fits_as_well(l)).count() > 1;
    for (located, weight) in distinct.iter_mut().zip(weights) {
        located.probability = if sum > 0.0 { weight / sum } else { 0.0 };
        located.is_certain = located.probability >= CERTAIN && !has_rival;
    }
    // Of equals, the one that fits best stays first.
    distinct.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    distinct
}

pub(super) fn is_near(a: &Pose, b: &Pose, within: (f64, f64)) -> bool {
    a.translation_distance(b) < within.0 && a.rotation_distance(b) < within.1
}
