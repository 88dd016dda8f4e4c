//! Quantiles of sorted values.

/// The quantile at `share` (0 to 1) of ascending values, by linear interpolation between ranks as NumPy and Open3D do it. None for no values, or
/// where it is not finite.
pub(super) fn interpolated<T: Copy + Into<f64>>(sorted: &[T], share: f64) -> Option<f64> {
    let rank = share * sorted.len().checked_sub(1)? as f64;
    let (lo, hi): (f64, f64) = (sorted[rank.floor() as usize].into(), sorted[rank.ceil() as usize].into());
    let value = if lo == hi { lo } else { lo + (hi - lo) * rank.fract() };
    value.is_finite().then_some(value)
}

/// The quantile at `share` (0 to 1) of ascending values, to the nearest rank: always one of the values. None for no values.
pub(super) fn nearest_rank(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (sorted.len() as f64 * share).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_few_values() {
        assert_eq!(interpolated(&[1.0f32, 2.0], 0.5), Some(1.5));
        assert_eq!(interpolated(&[1.0, f64::INFINITY], 0.5), None);
        assert_eq!(interpolated::<f64>(&[], 0.5), None);
        assert_eq!([nearest_rank(&[1.0, 2.0], 0.5), nearest_rank(&[1.0, 2.0], 0.95), nearest_rank(&[], 0.5)], [Some(1.0), Some(2.0), None]);
    }
}
