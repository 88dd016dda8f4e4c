//! What a series says of itself.

/// Mean of a slice; none when it is empty.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Mean of the last `count` values over that of the first; none where the two would overlap.
pub(crate) fn last_over_first(values: &[f64], count: usize) -> Option<f64> {
    if values.len() < 2 * count {
        return None;
    }
    Some(mean(&values[values.len() - count..])? / mean(&values[..count])?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_is_compared_with_the_beginning() {
        let values: Vec<f64> = (0..10).map(|i| if i < 5 { 2.0 } else { 3.0 }).collect();
        assert_eq!(last_over_first(&values, 5), Some(1.5));
        assert_eq!(last_over_first(&values, 6), None);
    }
}
