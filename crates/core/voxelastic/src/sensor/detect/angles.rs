//! Directions of points, and the statistics that find a sensor's steps in them.

use crate::Cloud;
use crate::simd::atan2;
use std::f32::consts::{PI, TAU};

/// A return in spherical coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Direction {
    /// Counter-clockwise from the x axis, -pi..=pi.
    pub(super) azimuth: f32,
    pub(super) elevation: f32,
    /// Horizontal distance and height, metres.
    pub(super) horizontal: f32,
    pub(super) height: f32,
}

impl Direction {
    pub(super) fn of(p: &[f32; 3]) -> Option<Self> {
        let horizontal = (p[0] * p[0] + p[1] * p[1]).sqrt();
        let is_return = Cloud::is_return(p) && horizontal.is_finite() && horizontal > 0.0;
        is_return.then(|| Self { azimuth: atan2(p[1], p[0]), elevation: atan2(p[2], horizontal), horizontal, height: p[2] })
    }
}

/// An angle brought to -pi..pi.
pub(super) fn wrap(angle: f32) -> f32 {
    let turned = angle - TAU * (angle / TAU).round();
    if turned >= PI { turned - TAU } else { turned }
}

/// Mean direction of angles, in double precision.
pub(super) fn circular_mean(angles: impl Iterator<Item = f32>) -> f32 {
    let (s, c) = angles.fold((0.0, 0.0), |(s, c), a| (s + f64::from(a).sin(), c + f64::from(a).cos()));
    s.atan2(c) as f32
}

/// The middle value; 0 of none.
pub(super) fn median(mut values: Vec<f32>) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// The most frequent positive value between `low` and `high`: the fullest cell of a logarithmic histogram, then the mean of
/// the values within a tenth of it. `None` when there are too few values.
pub(super) fn mode(values: &[f32], low: f32, high: f32) -> Option<f32> {
    const CELLS: usize = 256;
    const LEAST: usize = 50;
    let per_log = CELLS as f32 / (high / low).ln();
    let mut counts = [0u32; CELLS];
    let mut total = 0;
    for v in values.iter().filter(|v| (low..high).contains(*v)) {
        counts[(((v / low).ln() * per_log) as usize).min(CELLS - 1)] += 1;
        total += 1;
    }
    if total < LEAST {
        return None;
    }
    let smooth = |i: usize| counts[i.saturating_sub(1)] + 2 * counts[i] + counts[(i + 1).min(CELLS - 1)];
    let fullest = (0..CELLS).max_by_key(|&i| (smooth(i), CELLS - i))?;
    let centre = low * ((fullest as f32 + 0.5) / per_log).exp();
    let (sum, count) = values.iter().filter(|v| (**v - centre).abs() < 0.1 * centre).fold((0.0, 0), |(s, n), v| (s + f64::from(*v), n + 1));
    (count > 0).then(|| (sum / f64::from(count)) as f32)
}

/// Columns of a turn with this step; the usual powers of two are taken when they are as near as the step is certain.
pub(super) fn columns_of(step: f32) -> usize {
    let columns = TAU / step;
    let usual = [512f32, 1024.0, 2048.0, 4096.0];
    let snapped = usual.into_iter().find(|u| (columns - u).abs() < 0.015 * u).unwrap_or(columns.round());
    snapped.clamp(16.0, 16_384.0) as usize
}

/// Moves elevations apart so that they can be distinguished, keeping their order.
pub(super) fn separate(elevations: &mut [f32]) {
    let mut order: Vec<usize> = (0..elevations.len()).collect();
    order.sort_by(|&a, &b| elevations[b].total_cmp(&elevations[a]));
    let span = elevations[order[0]] - elevations[order[order.len() - 1]];
    let least = (span / 2000.0).max(1e-4);
    for pair in order.windows(2) {
        elevations[pair[1]] = elevations[pair[1]].min(elevations[pair[0]] - least);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mode_ignores_multiples_and_outliers() {
        let mut values: Vec<f32> = (0..500).map(|i| 0.0061 * (1.0 + 0.03 * ((i * 37 % 100) as f32 / 50.0 - 1.0))).collect();
        values.extend((0..200).map(|i| 0.0122 + 1e-5 * i as f32));
        assert!(mode(&values, 1e-4, 0.2).is_some_and(|m| (m - 0.0061).abs() < 5e-5));
        assert_eq!(mode(&values[..20], 1e-4, 0.2), None);
    }

    #[test]
    fn coinciding_rows_are_moved_apart() {
        let mut rows = vec![0.1, 0.3, 0.3, 0.2, 0.3];
        separate(&mut rows);
        let mut sorted = rows.clone();
        sorted.sort_by(f32::total_cmp);
        assert!(sorted.windows(2).all(|w| w[1] - w[0] > 5e-5), "{rows:?}");
        assert_eq!((rows[0], rows[3]), (0.1, 0.2));
    }
}
