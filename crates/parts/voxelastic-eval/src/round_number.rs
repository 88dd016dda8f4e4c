//! Round numbers for axes and scale bars.

/// The largest number of the form 1, 2 or 5 times a power of ten that is at most `limit`.
pub(crate) fn round_number(limit: f64) -> f64 {
    if !(limit > 0.0 && limit.is_finite()) {
        return 1.0;
    }
    let power = 10f64.powf(limit.log10().floor());
    [5.0, 2.0].into_iter().map(|f| f * power).find(|v| *v <= limit).unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_round() {
        assert_eq!([37.0, 0.07, 10.0].map(round_number), [20.0, 0.05, 10.0]);
    }
}
