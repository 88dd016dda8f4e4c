//! Trilinear interpolation among eight voxels, some of which may be unobserved.

use crate::field::tsdf::Voxel;

/// Corners of a cell whose distances differ by more than this many voxels belong to different surfaces (the band in front of one and the
/// band behind another) and are not interpolated. The distance to one surface changes by at most the cell's diagonal, 1.73.
const MAX_DIFFERENCE: f32 = 2.5;

/// Largest share of the interpolation weights at unobserved corners. With one half the observed region grows as much as it shrinks, but
/// lines of single voxels, left by single beams, break up; with this value they remain.
const MAX_MISSING: f32 = 0.55;

/// Eight neighbouring voxels of one scale and a point between them. Bit k of a corner's number is its side along axis k.
pub(super) struct Corners {
    voxels: [Voxel; 8],
    /// Position of the point between them, 0 to 1.
    fraction: [f32; 3],
    /// Interpolation weight of each corner; they sum to 1.
    shares: [f32; 8],
}

impl Corners {
    /// The voxels around the point at `fraction` between them; none if too many of them are unobserved.
    #[inline(always)]
    pub fn around(fraction: [f32; 3], voxels: [Voxel; 8]) -> Option<Self> {
        if voxels.iter().fold(0, |any, voxel| any | voxel.weight) == 0 {
            return None;
        }
        let along = fraction.map(|f| [1.0 - f, f]);
        let shares: [f32; 8] = std::array::from_fn(|i| along[0][i & 1] * along[1][i >> 1 & 1] * along[2][i >> 2]);
        let missing: f32 = (0..8).map(|i| if voxels[i].is_observed() { 0.0 } else { shares[i] }).sum();
        (missing <= MAX_MISSING).then_some(Self { voxels, fraction, shares })
    }

    /// The observed corner with the largest interpolation weight.
    pub fn nearest(&self) -> usize {
        let share = |i: usize| if self.voxels[i].is_observed() { self.shares[i] } else { 0.0 };
        (1..8).fold(0, |best, i| if share(i) > share(best) { i } else { best })
    }

    /// Distance in voxels of this scale, and weight. Trilinear if all eight are observed. Otherwise the observed ones are extrapolated to
    /// the point along the gradient between them, which is exact for planes. Between two surfaces, the values of the nearest corner.
    #[inline]
    pub fn interpolate(&self) -> (f32, f32) {
        let observed = self.voxels.map(Voxel::is_observed);
        let values = self.voxels.map(Voxel::distance_in_voxels);
        let (low, high) = (0..8).filter(|&i| observed[i]).fold((f32::MAX, f32::MIN), |(l, h), i| (l.min(values[i]), h.max(values[i])));
        if high - low > MAX_DIFFERENCE {
            let nearest = self.nearest();
            return (values[nearest], f32::from(self.voxels[nearest].weight));
        }
        let mean = |of: &[f32; 8]| (0..8).map(|i| self.shares[i] * of[i]).sum::<f32>();
        let weights = self.voxels.map(|voxel| f32::from(voxel.weight));
        if observed == [true; 8] {
            return (mean(&values), mean(&weights));
        }
        let gradient: [f32; 3] = std::array::from_fn(|k| {
            let pairs = (0..8).filter(|i| i >> k & 1 == 0 && observed[*i] && observed[i | 1 << k]);
            let (sum, count) = pairs.fold((0.0, 0), |(sum, count), i| (sum + values[i | 1 << k] - values[i], count + 1));
            if count == 0 { 0.0 } else { sum / count as f32 }
        });
        let along_gradient = |i: usize| (0..3).map(|k| gradient[k] * (self.fraction[k] - (i >> k & 1) as f32)).sum::<f32>();
        let known = mean(&observed.map(|o| f32::from(u8::from(o))));
        let extrapolated = std::array::from_fn(|i| if observed[i] { values[i] + along_gradient(i) } else { 0.0 });
        // Unobserved voxels have weight zero.
        (mean(&extrapolated) / known, mean(&weights) / known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::{DISTANCE_STEPS, WEIGHT_ONE};
    use proptest::prelude::*;

    /// Interpolates a plane with `normal` at `distance` voxels from the point `fraction`, with the corners of `observed` observed.
    fn plane(fraction: [f32; 3], distance: f32, normal: [f32; 3], observed: u8) -> Option<(f32, f32)> {
        let voxels = std::array::from_fn(|i| {
            let at: f32 = (0..3).map(|k| normal[k] * ((i >> k & 1) as f32 - fraction[k])).sum();
            let steps = ((distance + at) * DISTANCE_STEPS).round() as i16;
            if observed >> i & 1 == 1 { Voxel { distance: steps, weight: 3 * WEIGHT_ONE } } else { Voxel::default() }
        });
        Corners::around(fraction, voxels).map(|corners| corners.interpolate())
    }

    proptest! {
        #[test]
        fn a_plane_is_reproduced_where_enough_corners_are_observed(
            fraction in prop::array::uniform3(0f32..1.0), distance in -1f32..1.0, turn in prop::array::uniform2(-3f32..3.0), observed in any::<u8>(),
        ) {
            let normal = [turn[0].cos() * turn[1].cos(), turn[0].sin() * turn[1].cos(), turn[1].sin()];
            let share = |i: &usize| (0..3).map(|k| if i >> k & 1 == 1 { fraction[k] } else { 1.0 - fraction[k] }).product::<f32>();
            let known: f32 = (0..8).filter(|i| observed >> i & 1 == 1).map(|i| share(&i)).sum();
            prop_assume!((1.0 - MAX_MISSING - known).abs() > 1e-4);
            let found = plane(fraction, distance, normal, observed);
            prop_assert_eq!(found.is_some(), known > 1.0 - MAX_MISSING);
            let pairs = |k: usize| (0..8u32).any(|i| i >> k & 1 == 0 && observed >> i & 1 == 1 && observed >> (i | 1 << k) & 1 == 1);
            if let Some((found, weight)) = found {
                prop_assert!((weight - f32::from(3 * WEIGHT_ONE)).abs() < 1e-3);
                // Without two observed neighbours along an axis the gradient along it is unknown.
                prop_assert!((found - distance).abs() < if (0..3).all(pairs) { 2e-3 } else { 0.75 }, "{} instead of {}", found, distance);
            }
        }
    }

    #[test]
    fn distances_of_two_surfaces_are_not_interpolated() {
        let side = |i: usize| Voxel { distance: (if i & 1 == 0 { -1.25 } else { 1.5 } * DISTANCE_STEPS) as i16, weight: WEIGHT_ONE };
        let between = |first: Voxel| {
            let corners = Corners::around([0.3, 0.4, 0.4], std::array::from_fn(|i| if i == 0 { first } else { side(i) }));
            corners.map(|corners| corners.interpolate())
        };
        assert_eq!(between(Voxel { distance: -2048, weight: 32 }), Some((-1.0, 32.0)));
        assert_eq!(between(Voxel::default()), Some((-1.25, f32::from(WEIGHT_ONE))), "the next corner is on the same side");
    }
}
