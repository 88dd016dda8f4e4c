//! Fits of logistic models of what speaks against a place, in percent.

/// What speaks against a place.
pub type Doubts = [f64; 2];

/// A large weight counts against it a little, so that what is perfectly told apart has weights, too.
const RIDGE: f64 = 1e-4;

/// Weights for each of many choices among places, by the doubts of these and which is right: the probability of a place falls with the sum of its doubts.
pub fn weights_among(choices: &[(Vec<Doubts>, usize)]) -> Doubts {
    ascended(|weights: &Doubts| {
        let mut gradient = weights.map(|w| -2.0 * RIDGE * w);
        for (places, right) in choices {
            for (k, p) in shares(weights, places).into_iter().enumerate() {
                let off = p - f64::from(u8::from(k == *right));
                (0..2).for_each(|i| gradient[i] += off * places[k][i] / choices.len() as f64);
            }
        }
        gradient
    })
}

/// The probability of each place, if one of them is right.
pub fn shares(weights: &Doubts, places: &[Doubts]) -> Vec<f64> {
    let doubt = |place: &Doubts| weights[0] * place[0] + weights[1] * place[1];
    let least = places.iter().map(doubt).fold(f64::INFINITY, f64::min);
    let odds: Vec<f64> = places.iter().map(|place| (least - doubt(place)).exp()).collect();
    let sum: f64 = odds.iter().sum();
    odds.into_iter().map(|odds| odds / sum).collect()
}

/// Logarithm of the odds of a place without doubts, and how much it falls with these, by places that are right or not.
pub fn weights_against_none(places: &[(Doubts, bool)]) -> [f64; 3] {
    ascended(|weights: &[f64; 3]| {
        let mut gradient = [0.04, 1.0, 1.0].map(|ridge| -2.0 * RIDGE * ridge);
        gradient.iter_mut().zip(weights).for_each(|(gradient, weight)| *gradient *= weight);
        for ([fine, beside], is_right) in places {
            let odds = (weights[0] - weights[1] * fine - weights[2] * beside).exp();
            let off = (f64::from(u8::from(*is_right)) - odds / (1.0 + odds)) / places.len() as f64;
            [off, -off * fine, -off * beside].into_iter().zip(&mut gradient).for_each(|(part, gradient)| *gradient += part);
        }
        gradient
    })
}

/// Where the gradient leads to.
fn ascended<const N: usize>(gradient: impl Fn(&[f64; N]) -> [f64; N]) -> [f64; N] {
    let (mut weights, mut speed) = ([0.0; N], [0.0; N]);
    for _ in 0..20_000 {
        let slope = gradient(&weights);
        for k in 0..N {
            speed[k] = 0.9 * speed[k] + 0.02 * slope[k];
            weights[k] += speed[k];
        }
    }
    weights
}
