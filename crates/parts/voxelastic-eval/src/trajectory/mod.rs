//! Trajectory errors: absolute (ATE) and relative (RPE), after Sturm et al. 2012 (the TUM benchmark), with the conventions of `evo`.

mod associate;
mod fit;

pub use crate::stats::ErrorStats;
pub use associate::{Pair, StampedPose, by_id, by_time};

use crate::{EvalError, error::Result};
use serde::Serialize;
use voxelastic::Pose;

/// How the estimate is aligned with the reference before absolute errors are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fit {
    /// No alignment: both are in one frame.
    None,
    /// The rigid motion that minimises the squared distances (Horn, Umeyama).
    #[default]
    Rigid,
    /// The motion that aligns the first poses: the error is the drift from the start.
    FirstPose,
}

/// Absolute trajectory error.
#[derive(Clone, Debug, Serialize)]
pub struct Ate {
    /// Pose pairs compared.
    pub pairs: usize,
    /// Length of the reference's path, metres.
    pub path_m: f64,
    /// Distances between positions, metres.
    pub translation_m: ErrorStats,
    /// Angles between orientations, degrees.
    pub rotation_deg: ErrorStats,
    /// Translational error of each pair, metres, in order.
    #[serde(skip)]
    pub errors_m: Vec<f64>,
    /// Maps the estimate's frame to the reference's.
    #[serde(skip)]
    pub t_reference_estimate: Pose,
}

/// Absolute error of matched poses.
///
/// # Errors
/// [`EvalError::TooFew`] for less than one pair, or less than three for [`Fit::Rigid`].
pub fn ate(pairs: &[Pair], fit: Fit) -> Result<Ate> {
    let needed = if fit == Fit::Rigid { 3 } else { 1 };
    if pairs.len() < needed {
        return Err(EvalError::TooFew { what: "matched poses", found: pairs.len(), needed });
    }
    let t = match fit {
        Fit::None => Pose::identity(),
        Fit::FirstPose => pairs[0].reference * pairs[0].estimate.inverse(),
        Fit::Rigid => fit::rigid(pairs),
    };
    let moved: Vec<Pair> = pairs.iter().map(|p| Pair { estimate: t * p.estimate, ..*p }).collect();
    let errors_m: Vec<f64> = moved.iter().map(|p| (p.estimate.translation.vector - p.reference.translation.vector).norm()).collect();
    let angles: Vec<f64> = moved.iter().map(|p| angle_deg(&(p.reference.inverse() * p.estimate))).collect();
    Ok(Ate {
        pairs: pairs.len(),
        path_m: path(pairs).last().copied().unwrap_or(0.0),
        translation_m: ErrorStats::new(&errors_m),
        rotation_deg: ErrorStats::new(&angles),
        errors_m,
        t_reference_estimate: t,
    })
}

/// Distance between the poses of a pair in [`rpe`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Delta {
    /// This many poses apart; pairs start at every pose.
    Frames(usize),
    /// This far apart along the reference's path, metres; each pair starts where the one before ends.
    Metres(f64),
}

/// Relative pose error.
#[derive(Clone, Debug, Serialize)]
pub struct Rpe {
    /// Pairs of poses compared.
    pub pairs: usize,
    /// Translational errors of relative poses, metres.
    pub translation_m: ErrorStats,
    /// Rotational ones, degrees.
    pub rotation_deg: ErrorStats,
    /// Drift: sum of the translational errors over the distance travelled, percent. None without motion.
    pub drift_percent: Option<f64>,
}

/// Relative error of matched poses.
///
/// # Errors
/// [`EvalError::TooFew`] when the trajectory has no two poses that far apart; [`EvalError::Setting`] for a distance of zero or less.
pub fn rpe(pairs: &[Pair], delta: Delta) -> Result<Rpe> {
    let path = path(pairs);
    let spans = match delta {
        Delta::Frames(0) => return Err(EvalError::Setting { setting: "delta in frames", value: 0.0, must: "at least 1" }),
        Delta::Frames(n) => (n..pairs.len()).map(|j| (j - n, j)).collect(),
        Delta::Metres(d) if !(d > 0.0 && d.is_finite()) => return Err(EvalError::Setting { setting: "delta in metres", value: d, must: "positive" }),
        Delta::Metres(d) => spans_of(&path, d),
    };
    if spans.is_empty() {
        return Err(EvalError::TooFew { what: "pose pairs that far apart", found: 0, needed: 1 });
    }
    let relative = |&(i, j): &(usize, usize)| {
        let reference = pairs[i].reference.inverse() * pairs[j].reference;
        reference.inverse() * (pairs[i].estimate.inverse() * pairs[j].estimate)
    };
    let errors: Vec<Pose> = spans.iter().map(relative).collect();
    let lengths: Vec<f64> = errors.iter().map(|e| e.translation.vector.norm()).collect();
    let travelled: f64 = spans.iter().map(|(i, j)| path[*j] - path[*i]).sum();
    Ok(Rpe {
        pairs: spans.len(),
        translation_m: ErrorStats::new(&lengths),
        rotation_deg: ErrorStats::new(&errors.iter().map(angle_deg).collect::<Vec<_>>()),
        drift_percent: (travelled > 0.0).then(|| 100.0 * lengths.iter().sum::<f64>() / travelled),
    })
}

/// Distance travelled along the reference up to each pair, metres.
fn path(pairs: &[Pair]) -> Vec<f64> {
    let mut sum = 0.0;
    (0..pairs.len())
        .map(|i| {
            if i > 0 {
                sum += (pairs[i].reference.translation.vector - pairs[i - 1].reference.translation.vector).norm();
            }
            sum
        })
        .collect()
}

/// First and last index of consecutive spans of at least `d` metres.
fn spans_of(path: &[f64], d: f64) -> Vec<(usize, usize)> {
    let (mut out, mut start) = (Vec::new(), 0);
    for j in 1..path.len() {
        if path[j] - path[start] >= d {
            out.push((start, j));
            start = j;
        }
    }
    out
}

fn angle_deg(t: &Pose) -> f64 {
    t.rotation.angle().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn pose(x: f64, y: f64, z: f64, yaw: f64) -> Pose {
        Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(0.05 * yaw, 0.02, yaw))
    }

    fn drive(n: usize) -> Vec<Pose> {
        (0..n).map(|i| f64::from(i as u32) * 0.1).map(|s| pose(10.0 * s.sin(), 8.0 * (0.7 * s).cos(), 0.3 * s, s)).collect()
    }

    fn pairs(reference: &[Pose], estimate: &[Pose]) -> Vec<Pair> {
        reference.iter().zip(estimate).enumerate().map(|(i, (r, e))| Pair { time: i as f64, reference: *r, estimate: *e }).collect()
    }

    proptest! {
        #[test]
        fn aligned_copy_has_no_error(x in -50.0f64..50.0, y in -50.0f64..50.0, yaw in -3.0f64..3.0) {
            let (reference, t) = (drive(50), pose(x, y, 2.0, yaw));
            let estimate: Vec<Pose> = reference.iter().map(|p| t * p).collect();
            let p = pairs(&reference, &estimate);
            for fit in [Fit::Rigid, Fit::FirstPose] {
                let e = ate(&p, fit).unwrap();
                prop_assert!(e.translation_m.max < 1e-9 && e.rotation_deg.max < 1e-5, "{:?}", e.translation_m);
            }
            prop_assert!(rpe(&p, Delta::Metres(5.0)).unwrap().translation_m.max < 1e-9);
        }
    }

    #[test]
    fn rigid_fit_is_a_minimum() {
        let reference = drive(80);
        let estimate: Vec<Pose> = reference
            .iter()
            .enumerate()
            .map(|(i, p)| pose(0.0, 0.0, 0.0, 0.4) * p * pose((i as f64 * 0.9).sin() * 0.2, 0.1, (i as f64).cos() * 0.1, 0.0))
            .collect();
        let p = pairs(&reference, &estimate);
        let best = ate(&p, Fit::Rigid).unwrap();
        for d in [pose(0.01, 0.0, 0.0, 0.0), pose(0.0, -0.01, 0.0, 0.0), pose(0.0, 0.0, 0.01, 0.0), pose(0.0, 0.0, 0.0, 0.003)] {
            let t = d * best.t_reference_estimate;
            let moved: Vec<Pair> = p.iter().map(|q| Pair { estimate: t * q.estimate, ..*q }).collect();
            assert!(ate(&moved, Fit::None).unwrap().translation_m.rmse > best.translation_m.rmse);
        }
    }

    #[test]
    fn drift_of_one_percent() {
        let reference: Vec<Pose> = (0..=200).map(|i| pose(f64::from(i), 0.0, 0.0, 0.0)).collect();
        let estimate: Vec<Pose> = (0..=200).map(|i| pose(1.01 * f64::from(i), 0.0, 0.0, 0.0)).collect();
        let p = pairs(&reference, &estimate);
        let r = rpe(&p, Delta::Metres(10.0)).unwrap();
        assert_eq!(r.pairs, 20);
        assert!((r.drift_percent.unwrap() - 1.0).abs() < 1e-3 && (r.translation_m.rmse - 0.1).abs() < 1e-4);
        let a = ate(&p, Fit::FirstPose).unwrap();
        assert!((a.translation_m.max - 2.0).abs() < 1e-9 && (a.path_m - 200.0).abs() < 1e-9);
        assert_eq!(rpe(&p, Delta::Frames(1)).unwrap().pairs, 200);
    }

    #[test]
    fn short_trajectories_and_bad_deltas_are_rejected() {
        let p = pairs(&drive(2), &drive(2));
        assert!(matches!(ate(&p, Fit::Rigid), Err(EvalError::TooFew { found: 2, needed: 3, .. })));
        assert!(matches!(ate(&[], Fit::None), Err(EvalError::TooFew { .. })));
        assert!(matches!(rpe(&p, Delta::Metres(100.0)), Err(EvalError::TooFew { .. })));
        assert!(matches!(rpe(&p, Delta::Metres(f64::NAN)), Err(EvalError::Setting { .. })));
        assert!(matches!(rpe(&p, Delta::Frames(0)), Err(EvalError::Setting { .. })));
    }
}
