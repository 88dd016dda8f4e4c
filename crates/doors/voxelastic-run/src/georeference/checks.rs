//! Fixes that are not what they seem: of another unit, with latitude and longitude swapped, mirrored, of another clock.

use super::request::Clock;
use crate::error::{Error, Result};
use crate::warning::{Code, Warnings};
use nalgebra::{Matrix3, Vector3};
use voxelastic_earth::{Alignment, LEAP_SECONDS, Pair, TimeOffset};

/// Units that people have taken for metres.
const UNITS: [(f64, &str); 4] = [(3.2808, "feet"), (0.3048, "metres, and the map in feet"), (100.0, "centimetres"), (1000.0, "millimetres")];
/// Lengths of map and fixes that differ by more than this do not belong together; by less, it is said.
const SCALE: (f64, f64) = (0.2, 0.02);

/// Distances between fixes as a multiple of those in the map, by their median; none if all are near each other.
fn scale(pairs: &[Pair]) -> Option<f64> {
    let half = pairs.len() / 2;
    let ratios = pairs.iter().zip(pairs.iter().skip(half)).filter_map(|(a, b)| {
        let (there, here) = ((a.measured - b.measured).norm(), (a.in_map - b.in_map).norm());
        let sigma = (a.covariance.trace() + b.covariance.trace()).sqrt();
        (here.min(there) > 20.0 * sigma).then_some(there / here)
    });
    let mut ratios: Vec<f64> = ratios.collect();
    if ratios.len() < 5 {
        return None;
    }
    ratios.sort_by(f64::total_cmp);
    Some(ratios[ratios.len() / 2])
}

/// Refuses fixes whose distances are not those of the map, and an alignment that lays the map on its head.
///
/// # Errors
/// With what they seem to be.
pub fn check(file: &str, pairs: &[Pair], found: &Alignment, has_degrees: bool, warnings: &mut Warnings) -> Result<()> {
    let swapped = "latitude and longitude may be swapped: name the columns in the order that they have";
    let upside = (found.t_plane_map.rotation * Vector3::z()).z;
    if let Some(scale) = scale(pairs) {
        if (scale - 1.0).abs() > SCALE.0 {
            let unit = UNITS.iter().find(|(unit, _)| (scale / unit - 1.0).abs() < 0.1);
            let words = unit.map_or_else(String::new, |(_, name)| format!(": they seem to be in {name}"));
            let remedy = if has_degrees { swapped } else { "convert the coordinates to metres, or name the system that they are in with --crs" };
            let message = format!("{file}: distances between fixes are {scale:.3} times those in the map{words}");
            return Err(Error::new(message, remedy));
        }
        if (scale - 1.0).abs() > SCALE.1 {
            let text =
                format!("distances between fixes are {scale:.3} times those in the map: it drifts in scale, or one of the two is not in metres");
            warnings.add(Code::FixesDisagree, text, "");
        }
    }
    if upside < 0.5 {
        let message = format!("{file}: the map fits the fixes only tilted by {:.0} degrees: one of them is mirrored", upside.acos().to_degrees());
        let remedy = "latitude and longitude, or east and north, may be swapped, or have the wrong sign: south and west are negative";
        return Err(Error::new(message, remedy));
    }
    if found.sigmas[2] > 0.1 {
        let degrees = found.sigmas[2].to_degrees();
        let text = format!("the heading of the map is known to {degrees:.0} degrees only: the fixes are too near each other");
        warnings.add(Code::FixesDisagree, text, "give fixes that are farther apart");
    }
    Ok(())
}

/// An offset that makes residuals smaller than this part of them is another clock, and no matter of drift.
const OTHER_CLOCK: f64 = 0.5;

/// The offset of the clocks that is used: the one that was found, if that was asked for. One near that of GPS time and UTC is that.
///
/// # Errors
/// Fixes of another clock, which nobody asked to find.
pub fn offset(file: &str, found: Option<&TimeOffset>, clock: Clock, warnings: &mut Warnings) -> Result<f64> {
    let Some(TimeOffset { seconds, before_m, after_m }) = found else { return Ok(0.0) };
    let is_leap = (seconds.abs() - LEAP_SECONDS).abs() < 0.5;
    let seconds = if is_leap { LEAP_SECONDS.copysign(*seconds) } else { *seconds };
    let why = if is_leap { ": GPS time is ahead of UTC by 18 s" } else { "" };
    let before = if before_m.is_finite() { format!("{before_m:.2} m") } else { "no overlap".to_owned() };
    let text = format!("{file}: fixes fit best with {seconds:+.2} s added to their times{why} (median residual {after_m:.2} m, {before} without)");
    if clock == Clock::Find {
        tracing::info!("{text}");
        return Ok(seconds);
    }
    if !before_m.is_finite() || *after_m < OTHER_CLOCK * before_m {
        return Err(Error::new(text, "`--time-offset auto` adds that; `--time-offset 0` takes the times as they are"));
    }
    warnings.add(Code::OtherClock, text, "`--time-offset auto` adds that");
    Ok(0.0)
}

/// The covariance of a fix, with what correlation in time makes of it: of fixes of a metre that stay off for a minute, sixty say no more than one.
pub fn correlated(covariance: &Matrix3<f64>, correlation_s: f64, interval_s: f64) -> Matrix3<f64> {
    if correlation_s <= 0.0 || interval_s <= 0.0 {
        return *covariance;
    }
    covariance * (2.0 * correlation_s / interval_s).max(1.0)
}
