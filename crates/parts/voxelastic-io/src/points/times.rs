//! Times of points: the units of the drivers, and relative to absolute.

use super::record::Scalar;
use super::roles::CURVATURE;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use voxelastic::Cloud;

/// No sweep takes longer, seconds.
const LONGEST_SWEEP: f64 = 60.0;
/// Larger times are absolute, not relative to their sweep, seconds.
const LARGEST_RELATIVE: f64 = 2.0;

/// Times from 0 to 1, to within this, are shares of a sweep: no sensor turns once a second.
const SHARE_TOLERANCE: f64 = 0.02;

/// A sweep lasts this long, seconds: the unit of times under which one does is theirs. The ends are less than a thousand apart, so that it is one unit.
const SWEEP: [f64; 2] = [1e-2, 1.9];
/// The same for the unit that a driver's type of numbers stands for, which is believed in doubt.
const USUAL_SWEEP: [f64; 2] = [5e-4, 2.5];

/// From here on, the floats of 32 bits that a sweep takes must differ by many steps, or they cannot hold its times: dates in seconds cannot.
const LARGEST_FINE: f64 = 1e6;
const LEAST_STEPS: f64 = 64.0;
/// Whether that was said: it is so of every cloud.
static SAID_COARSE: AtomicBool = AtomicBool::new(false);

/// What the times of a cloud's points are.
#[derive(Debug, Default)]
pub(super) struct TimesOfPoints {
    /// Seconds, or shares of the sweep.
    pub(super) time: Option<Vec<f32>>,
    /// What they are relative to, seconds, if they were absolute.
    pub(super) stamp: Option<f64>,
    /// Whether they are shares of the sweep, 0 to 1.
    pub(super) has_shares: bool,
}

/// Times in seconds relative to a stamp: the earliest point's if the file has absolute times, else the cloud's own.
pub(super) fn relative_times(mut values: Vec<f64>, points: &[[f32; 3]], name: &str, scalar: Scalar, path: &Path) -> TimesOfPoints {
    let is_known = |&(t, p): &(&f64, &[f32; 3])| t.is_finite() & Cloud::is_return(p);
    if scalar == Scalar::U32 {
        unwrap(&mut values);
    }
    let Some(first) = values.iter().zip(points).find(is_known).map(|(t, _)| *t) else { return TimesOfPoints::default() };
    let is_curvature = name.eq_ignore_ascii_case(CURVATURE);
    let usual = if is_curvature { 1e-3 } else { usual_unit_s(scalar, first) };
    let all = bounds(&values, first);
    let known = || values.iter().zip(points).filter(is_known).map(|(t, _)| *t);
    let is_coarse = |first: f64| {
        let (low, high) = known().fold((first, first), |(low, high), t| (low.min(t), high.max(t)));
        high - low < LEAST_STEPS * first.abs() * f64::from(f32::EPSILON)
    };
    if scalar == Scalar::F32 && first.abs() > LARGEST_FINE && is_coarse(first) {
        if !SAID_COARSE.swap(true, Ordering::Relaxed) {
            tracing::warn!("{}: floats of 32 bits cannot hold the times in field {name}, {first}: ignored; write them as 64 bits", path.display());
        }
        return TimesOfPoints::default();
    }
    // Times that are all the same say nothing of their unit.
    let ((low, high), unit) = if !is_curvature && (all.0 == all.1 || lasts(all.1 - all.0, usual, USUAL_SWEEP)) {
        (all, usual)
    } else {
        // Points without a return may have any time. Leaving them out is slower and rarely needed.
        let known: Vec<f64> = known().collect();
        (bounds(&known, first), unit_s(known, usual))
    };
    // The curvature of a surface is at most 1/3; a sweep lasts longer than a third of a millisecond.
    if is_curvature && low >= 0.0 && high <= 1.0 / 3.0 {
        return TimesOfPoints::default();
    }
    if (high - low) * unit > LONGEST_SWEEP {
        tracing::warn!("{}: the times in field {name} span {:.0} s, more than a sweep can take: ignored", path.display(), (high - low) * unit);
        return TimesOfPoints::default();
    }
    // As seconds they would bend every sweep by ten times of what the sensor moved.
    let has_shares = scalar.is_float() && unit == 1.0 && low.abs() < SHARE_TOLERANCE && (high - 1.0).abs() < SHARE_TOLERANCE;
    let stamp = Some(low * unit).filter(|s| s.abs() > LARGEST_RELATIVE);
    let origin = if stamp.is_some() { low } else { 0.0 };
    let relative = |t: f64| {
        let t = (t - origin) * unit;
        (if t.abs() <= LONGEST_SWEEP + LARGEST_RELATIVE { t } else { 0.0 }) as f32
    };
    TimesOfPoints { time: Some(values.iter().map(|&t| relative(t)).collect()), stamp, has_shares }
}

/// Counters of 32 bits begin anew, of nanoseconds every 4.3 s: where a sweep goes over that, what is after it is counted on. Points without a return often have 0,
/// which says nothing.
fn unwrap(values: &mut [f64]) {
    const TURN: f64 = (1u64 << 32) as f64;
    let (low, high) = bounds(values, values.first().copied().unwrap_or(0.0));
    let is_early = |t: f64| t < TURN / 8.0;
    let goes_over =
        high - low > TURN / 2.0 && values.iter().all(|t| is_early(*t) || *t > TURN * 7.0 / 8.0) && values.iter().any(|t| *t > 0.0 && is_early(*t));
    if goes_over {
        values.iter_mut().filter(|t| is_early(**t)).for_each(|t| *t += TURN);
    }
}

/// The least and the largest of the finite times and of `first`, in SIMD lanes.
fn bounds(times: &[f64], first: f64) -> (f64, f64) {
    const LANES: usize = 8;
    let (whole, rest) = times.as_chunks::<LANES>();
    let mut last = [first; LANES];
    last[..rest.len()].copy_from_slice(rest);
    let (mut low, mut high) = ([first; LANES], [first; LANES]);
    for times in whole.iter().chain([&last]) {
        for ((&t, low), high) in times.iter().zip(&mut low).zip(&mut high) {
            let t = if t.is_finite() { t } else { first };
            *low = if t < *low { t } else { *low };
            *high = if t > *high { t } else { *high };
        }
    }
    (low.into_iter().fold(first, f64::min), high.into_iter().fold(first, f64::max))
}

/// Seconds per unit of a time field as drivers mean it: integers count nanoseconds, as those of Ouster and Livox do; floats are seconds, unless they can only be a date (since
/// 1970) in milliseconds, microseconds or nanoseconds.
fn usual_unit_s(scalar: Scalar, first: f64) -> f64 {
    match first.abs() {
        _ if !scalar.is_float() => 1e-9,
        t if t >= 1e17 => 1e-9,
        t if t >= 1e14 => 1e-6,
        t if t >= 1e11 => 1e-3,
        _ => 1.0,
    }
}

/// Seconds per unit of the times of a sweep: the usual unit, but where a sweep cannot last as long as that says, the one under which it can. Most times decide, not a few that are
/// wrong.
fn unit_s(mut times: Vec<f64>, usual: f64) -> f64 {
    let last = times.len() - 1;
    let mut at = |tenths: usize| *times.select_nth_unstable_by((last * tenths + 5) / 10, f64::total_cmp).1;
    let duration = (at(9) - at(1)) / 0.8;
    if lasts(duration, usual, USUAL_SWEEP) {
        return usual;
    }
    [1.0, 1e-3, 1e-6, 1e-9].into_iter().find(|unit| lasts(duration, *unit, SWEEP)).unwrap_or(usual)
}

/// Whether a duration in a unit of so many seconds is within limits, seconds.
fn lasts(duration: f64, unit: f64, [shortest, longest]: [f64; 2]) -> bool {
    (shortest..=longest).contains(&(duration * unit))
}
