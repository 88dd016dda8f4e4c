//! By how much the clocks of a map and of its fixes differ.

use crate::{Pair, Track, align};
use nalgebra::{Matrix3, Point3, Vector3};

/// Offsets that are looked at, seconds either way.
const REACH: f64 = 20.0;
/// Fixes that are looked at.
const MOST: usize = 250;
/// One that makes the residuals smaller by less than this is none.
const GAIN: f64 = 0.75;

/// Another clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeOffset {
    /// To be added to the times of fixes, seconds.
    pub seconds: f64,
    /// Median residual of a rigid alignment without it, metres.
    pub before_m: f64,
    /// With it.
    pub after_m: f64,
}

/// Finds the offset with which fixes, as times and places in a plane (east, north, up, metres), fit a trajectory best; none if that is next to nothing, or they fit
/// hardly better. `lever` is the antenna in the frame of the sensor, metres.
pub fn time_offset(track: &Track, fixes: &[(f64, Vector3<f64>)], lever: &Vector3<f64>) -> Option<TimeOffset> {
    let stride = fixes.len().div_ceil(MOST).max(1);
    let some: Vec<(f64, Vector3<f64>)> = fixes.iter().step_by(stride).copied().collect();
    let median = |seconds: f64| median_residual(track, &some, lever, seconds);
    let before = median(0.0);
    let coarse = steps(-REACH, REACH, 0.5).map(|s| (median(s), s));
    let (_, start) = coarse.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.abs().total_cmp(&b.1.abs())))?;
    let fine =
        steps(start - 0.5, start + 0.5, 0.05).map(|s| (median(s), s)).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.abs().total_cmp(&b.1.abs())))?;
    let (after_m, seconds) = fine;
    let is_any = after_m.is_finite() && seconds.abs() > 0.04 && (!before.is_finite() || after_m < GAIN * before);
    is_any.then_some(TimeOffset { seconds, before_m: before, after_m })
}

fn steps(from: f64, to: f64, step: f64) -> impl Iterator<Item = f64> {
    let count = ((to - from) / step).round() as i32;
    (0..=count).map(move |k| from + f64::from(k) * step)
}

/// The median residual; infinite if fewer than half of the fixes are within the times of the track.
fn median_residual(track: &Track, fixes: &[(f64, Vector3<f64>)], lever: &Vector3<f64>, seconds: f64) -> f64 {
    let pair = |(time, measured): &(f64, Vector3<f64>)| {
        let moment = track.at(time + seconds)?;
        Some(Pair { in_map: (moment.t_map_sensor * Point3::from(*lever)).coords, measured: *measured, covariance: Matrix3::identity() })
    };
    let pairs: Vec<Pair> = fixes.iter().filter_map(pair).collect();
    if 2 * pairs.len() < fixes.len().min(track.times().len()) || pairs.len() < 8 {
        return f64::INFINITY;
    }
    let Some(found) = align(&pairs) else { return f64::INFINITY };
    let mut lengths: Vec<f64> = pairs.iter().map(|pair| found.residual(pair).norm()).collect();
    let middle = lengths.len() / 2;
    *lengths.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;

    #[test]
    fn leap_seconds_and_a_tenth_are_found_and_nothing_is_not() {
        // A drive with curves at a speed that changes.
        let place = |t: f64| Vector3::new(8.0 * t + 10.0 * (0.2 * t).sin(), 40.0 * (0.07 * t).sin(), 0.5 * (0.05 * t).sin());
        let track = Track::new((0..600).map(|k| (f64::from(k) * 0.25, Pose::from(place(f64::from(k) * 0.25)))));
        for off in [18.0, -0.3, 0.0] {
            let fixes: Vec<(f64, Vector3<f64>)> = (20..130).map(|k| (f64::from(k) + off, place(f64::from(k)))).collect();
            let found = time_offset(&track, &fixes, &Vector3::zeros()).map(|found| found.seconds);
            match found {
                Some(seconds) => assert!((seconds + off).abs() < 0.06, "{off}: {seconds}"),
                None => assert_eq!(off, 0.0),
            }
        }
    }
}
