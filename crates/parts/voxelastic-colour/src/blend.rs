//! One colour from several observations.

use crate::light::to_scale;
use crate::observations::Observations;

/// Observations that differ by more than this from the median, on the sRGB scale of 0 to 1, are of something else: a reflection, a passer-by, an edge.
const AGREES: f32 = 0.1;
/// A clipped channel is at least as bright as it looks: such observations count this much.
const CLIPPED: f32 = 0.05;
/// Light from which on a channel counts as clipped.
const BRIGHT: f32 = 0.95;

/// Linear light of a vertex: the weighted mean of what agrees with the weighted median of the observations, each divided by the exposure of its image.
/// `None` without observations.
pub(crate) fn blend(observations: &Observations, exposures: &[[f32; 3]]) -> Option<[f32; 3]> {
    let all: Vec<(f32, [f32; 3])> = observations
        .all()
        .iter()
        .map(|o| {
            let (light, exposure) = (o.light(), exposures[o.image as usize]);
            let weight = if light.iter().any(|c| *c > BRIGHT) { o.weight * CLIPPED } else { o.weight };
            (weight, std::array::from_fn(|k| light[k] / exposure[k]))
        })
        .collect();
    let centre = all.first().map(|_| std::array::from_fn(|k| median(all.iter().map(|(w, light)| (light[k], *w)).collect())))?;
    let agrees = |light: &[f32; 3]| (0..3).all(|k| (to_scale(light[k]) - to_scale(centre[k])).abs() <= AGREES);
    let (mut sum, mut weights) = ([0.0; 3], 0.0);
    for (weight, light) in all.iter().filter(|(_, light)| agrees(light)) {
        (0..3).for_each(|k| sum[k] += weight * light[k]);
        weights += weight;
    }
    // Medians of channels may be of different observations, none of which agrees with all of them.
    Some(if weights > 0.0 { sum.map(|s| s / weights) } else { centre })
}

/// The weighted median: half of the weight is at or below it.
fn median(mut values: Vec<(f32, f32)>) -> f32 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, w)| w).sum::<f32>();
    let mut below = 0.0;
    let found = values.iter().find(|(_, w)| {
        below += w;
        below >= half
    });
    found.or(values.last()).map_or(0.0, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observations::Observation;

    fn observed(observations: &[(u32, f32, f32)]) -> Observations {
        let mut all = Observations::default();
        observations.iter().for_each(|&(image, weight, light)| all.add(Observation::new(image, weight, [light; 3])));
        all
    }

    #[test]
    fn outliers_do_not_count_and_exposures_are_divided_out() {
        let exposures = [[1.0; 3], [2.0; 3], [1.0; 3], [1.0; 3]];
        let one = |observations: &[(u32, f32, f32)]| blend(&observed(observations), &exposures).map(|c| c[0]);
        assert_eq!(one(&[]), None);
        assert!((one(&[(0, 1.0, 0.2), (1, 1.0, 0.4), (2, 1.5, 0.9), (3, 1.0, 0.21)]).unwrap() - 0.2033).abs() < 1e-3);
        // A clipped observation counts little.
        assert!((one(&[(0, 1.0, 0.9), (2, 3.0, 1.0)]).unwrap() - 0.9).abs() < 0.02);
    }

    #[test]
    fn medians_are_weighted() {
        assert_eq!(median(vec![(3.0, 1.0), (1.0, 1.0), (2.0, 1.0)]), 2.0);
        assert_eq!(median(vec![(3.0, 9.0), (1.0, 1.0), (2.0, 1.0)]), 3.0);
    }
}
