//! A choice among candidates and none of them, each by a weight that grows with its features: the model by which places are probable, and the fit of its weights.

/// Features of a candidate; the first is 1.
pub type Features = [f64; FEATURES];
/// Number of features.
pub const FEATURES: usize = 5;

/// Candidates, and which of them is right, if any is.
#[derive(Clone, Debug)]
pub struct Choice {
    pub candidates: Vec<Features>,
    pub right: Option<usize>,
}

/// Probability of each candidate; what is left is that of none.
pub fn probabilities(weights: &Features, candidates: &[Features]) -> Vec<f64> {
    let exponent = |features: &Features| features.iter().zip(weights).map(|(f, w)| f * w).sum::<f64>().min(50.0);
    let odds: Vec<f64> = candidates.iter().map(|features| exponent(features).exp()).collect();
    let sum = 1.0 + odds.iter().sum::<f64>();
    odds.into_iter().map(|odds| odds / sum).collect()
}

/// The weights that make what was chosen most likely, by gradient ascent; large weights count against it a little.
pub fn fitted(choices: &[Choice]) -> Features {
    const RIDGE: f64 = 1e-3;
    let count: f64 = choices.iter().map(|c| c.candidates.len() as f64).sum();
    let scale: Features =
        std::array::from_fn(|k| (choices.iter().flat_map(|c| &c.candidates).map(|f| f[k] * f[k]).sum::<f64>() / count).sqrt().max(1e-6));
    // In features of unit size.
    let (mut weights, mut slope) = ([0.0; FEATURES], [0.0; FEATURES]);
    for _ in 0..4000 {
        let scaled: Features = std::array::from_fn(|k| weights[k] / scale[k]);
        let mut gradient: Features = std::array::from_fn(|k| -RIDGE * weights[k]);
        for choice in choices {
            for (k, (features, p)) in choice.candidates.iter().zip(probabilities(&scaled, &choice.candidates)).enumerate() {
                let off = f64::from(u8::from(choice.right == Some(k))) - p;
                (0..FEATURES).for_each(|i| gradient[i] += off * features[i] / scale[i] / choices.len() as f64);
            }
        }
        for i in 0..FEATURES {
            slope[i] = 0.95 * slope[i] + gradient[i];
            weights[i] += slope[i];
        }
    }
    std::array::from_fn(|k| weights[k] / scale[k])
}
