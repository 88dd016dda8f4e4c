//! Exposures of images: a factor for each image and channel, so that images agree on the vertices that several of them see.
//!
//! What image i shows of a vertex is its light times the exposure of i. The logarithm of the ratio of two images is thus the same at all vertices, up to
//! what shines or moved; its median is a measurement of the difference of their logarithms. Weighted least squares over all pairs, made robust by
//! repeating it with less weight for pairs that do not fit, gives all exposures but for a common factor: their mean logarithm is zero.

use crate::observations::Observations;
use rayon::prelude::*;

/// Light is compared within this range: darker is noise, brighter may be clipped.
const COMPARED: std::ops::Range<f32> = 0.005..0.85;
/// Vertices that are compared, spread over the mesh.
const VERTICES: usize = 300_000;
/// Fewer vertices that two images have in common say nothing.
const LEAST_COMMON: usize = 20;
/// More vertices than these do not count more: neighbours err alike.
const MOST_COUNTED: f64 = 400.0;
/// A pair that is off by this much, in logarithms, counts half.
const TOLERANCE: f64 = 0.05;
/// Rounds of least squares.
const ROUNDS: usize = 6;
/// Holds exposures at one against measurements of that weight: a chain of many images must not drift away.
const PRIOR_WEIGHT: f64 = 0.02;

/// What two images say about their exposures.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair {
    images: [usize; 2],
    /// Logarithm of the second over the first, per channel.
    ratio: [f64; 3],
    /// Vertices in common.
    weight: f64,
}

/// Exposures of `images` images, per channel, with a geometric mean of one; an image that nothing connects to others has one.
pub(crate) fn exposures(vertices: &[Observations], images: usize) -> Vec<[f32; 3]> {
    let pairs = pairs(vertices);
    let channels: Vec<Vec<f64>> = (0..3).map(|channel| solve(&pairs, images, channel)).collect();
    (0..images).map(|i| std::array::from_fn(|channel| channels[channel][i].exp() as f32)).collect()
}

/// Medians of the ratios of all pairs of images, in the order of their numbers.
fn pairs(vertices: &[Observations]) -> Vec<Pair> {
    let step = vertices.len() / VERTICES + 1;
    let ratios = |vertex: &Observations| {
        let all = vertex.all();
        let usable = |light: &[f32; 3]| light.iter().all(|c| COMPARED.contains(c));
        let mut found: Vec<([u32; 2], [f32; 3])> = Vec::new();
        for (k, a) in all.iter().enumerate() {
            for b in &all[k + 1..] {
                let (a, b) = if a.image < b.image { (a, b) } else { (b, a) };
                let (from, to) = (a.light(), b.light());
                if usable(&from) && usable(&to) {
                    found.push(([a.image, b.image], std::array::from_fn(|c| (to[c] / from[c]).ln())));
                }
            }
        }
        found
    };
    let mut all: Vec<([u32; 2], [f32; 3])> = vertices.par_iter().step_by(step).flat_map_iter(ratios).collect();
    all.par_sort_by_key(|(images, _)| *images);
    let groups: Vec<&[([u32; 2], [f32; 3])]> = all.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() >= LEAST_COMMON).collect();
    groups
        .par_iter()
        .map(|group| {
            let median = |channel: usize| {
                let mut values: Vec<f32> = group.iter().map(|(_, ratio)| ratio[channel]).collect();
                let middle = values.len() / 2;
                f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
            };
            Pair {
                images: group[0].0.map(|i| i as usize),
                ratio: std::array::from_fn(median),
                weight: (group.len() as f64).min(MOST_COUNTED) / MOST_COUNTED,
            }
        })
        .collect()
}

/// Logarithms of the exposures of a channel.
fn solve(pairs: &[Pair], images: usize, channel: usize) -> Vec<f64> {
    let mut x = vec![0.0; images];
    let mut weights: Vec<f64> = pairs.iter().map(|pair| pair.weight).collect();
    for _ in 0..ROUNDS {
        x = conjugate_gradients(pairs, &weights, channel, x);
        for (weight, pair) in weights.iter_mut().zip(pairs) {
            let [a, b] = pair.images;
            let off = (x[b] - x[a] - pair.ratio[channel]) / TOLERANCE;
            *weight = pair.weight / (1.0 + off * off);
        }
    }
    let mean = x.iter().sum::<f64>() / images.max(1) as f64;
    let mut connected = vec![false; images];
    pairs.iter().flat_map(|pair| pair.images).for_each(|i| connected[i] = true);
    x.iter().zip(connected).map(|(x, connected)| if connected { x - mean } else { 0.0 }).collect()
}

/// Minimises the weighted squares from `x` on.
fn conjugate_gradients(pairs: &[Pair], weights: &[f64], channel: usize, mut x: Vec<f64>) -> Vec<f64> {
    let product = |v: &[f64]| {
        let mut out: Vec<f64> = v.iter().map(|v| PRIOR_WEIGHT * v).collect();
        for (pair, w) in pairs.iter().zip(weights) {
            let [a, b] = pair.images;
            let off = w * (v[b] - v[a]);
            (out[b], out[a]) = (out[b] + off, out[a] - off);
        }
        out
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut wanted = vec![0.0; x.len()];
    for (pair, w) in pairs.iter().zip(weights) {
        let [a, b] = pair.images;
        (wanted[b], wanted[a]) = (wanted[b] + w * pair.ratio[channel], wanted[a] - w * pair.ratio[channel]);
    }
    let mut residual: Vec<f64> = wanted.iter().zip(product(&x)).map(|(b, ax)| b - ax).collect();
    let mut direction = residual.clone();
    let mut error = dot(&residual, &residual);
    for _ in 0..2 * x.len() + 20 {
        if error < 1e-20 {
            break;
        }
        let along = product(&direction);
        let step = error / dot(&direction, &along);
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        residual.iter_mut().zip(&along).for_each(|(r, a)| *r -= step * a);
        let next = dot(&residual, &residual);
        direction.iter_mut().zip(&residual).for_each(|(d, r)| *d = r + next / error * *d);
        error = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observations::Observation;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        /// Random exposures, vertices that each see a few neighbouring images, and some that shine: exposures come back.
        #[test]
        fn exposures_come_back(logs in proptest::collection::vec(-0.7..0.7f64, 3..9), seed in 0u64..1000) {
            let mut state = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let mut random = || { state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407); (state >> 40) as f64 / (1u64 << 24) as f64 };
            let images = logs.len();
            let mut vertices = vec![Observations::default(); 3000];
            for vertex in &mut vertices {
                let light = [0.05 + 0.2 * random(), 0.05 + 0.2 * random(), 0.05 + 0.2 * random()];
                let first = (random() * images as f64) as usize;
                for (i, log) in logs.iter().enumerate().skip(first).take(3) {
                    let shines = if random() < 0.1 { 3.0 } else { 1.0 };
                    vertex.add(Observation::new(i as u32, 1.0, light.map(|c| (c * log.exp() * shines) as f32)));
                }
            }
            let mean = logs.iter().sum::<f64>() / images as f64;
            let found = exposures(&vertices, images);
            for (log, found) in logs.iter().zip(&found) {
                for f in found {
                    prop_assert!((f64::from(*f).ln() - (log - mean)).abs() < 0.05, "{found:?} for {log} - {mean}");
                }
            }
        }
    }

    #[test]
    fn without_vertices_in_common_exposures_are_one() {
        let mut vertex = Observations::default();
        vertex.add(Observation::new(0, 1.0, [0.2; 3]));
        assert_eq!(exposures(&[vertex], 3), [[1.0; 3]; 3]);
        assert!(exposures(&[], 0).is_empty());
    }
}
