//! Least-squares fit of a power law.

/// The exponent b of y = a x^b by least squares of the logarithms; none for fewer than two different x, or if a value is not positive.
pub(super) fn exponent(points: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.into_iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    if logs.iter().any(|(x, y)| !(x.is_finite() && y.is_finite())) {
        return None;
    }
    let n = logs.len() as f64;
    let (mean_x, mean_y) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
    let variance: f64 = logs.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    let covariance: f64 = logs.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    (variance > 1e-12).then(|| covariance / variance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_exponents() {
        for power in [-1.5, 0.0, 0.5, 2.0] {
            let points = [1.0f64, 2.0, 5.0, 7.0].map(|x| (x, 3.0 * x.powf(power)));
            assert!((exponent(points).unwrap() - power).abs() < 1e-12);
        }
        assert_eq!(exponent([(1.0, 2.0)]), None);
        assert_eq!(exponent([(1.0, 2.0), (2.0, 0.0)]), None);
        assert_eq!(exponent([]), None);
    }
}
