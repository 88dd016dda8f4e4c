//! A point between eight voxels: whether the field is known there, and how far the surface is.

use crate::field::tsdf::Voxel;

/// Neighbouring samples that differ by more than this many voxels are not of one surface: between the band in front of one and the band
/// behind another there is nothing to interpolate. A distance changes by at most the diagonal, 1.73, within a cell.
const ONE_SURFACE: f32 = 2.5;

/// Share of the interpolation that may be unobserved. With half, what is known grows as much as it shrinks, but what single beams left, a voxel wide,
/// is torn apart; this much more keeps it.
const MOST_MISSING: f32 = 0.55;

/// Eight neighbouring voxels of one scale, and a point between them. Bit k of a corner's number is the side along axis k.
pub(super) struct Corners {
    voxels: [Voxel; 8],
    /// Place of the point between them, 0 to 1.
    fraction: [f32; 3],
    /// What each of them has to say of the point, together 1.
    shares: [f32; 8],
}

impl Corners {
    /// The voxels around a point that lies at `fraction` between them, unless too little of them was observed.
    #[inline(always)]
    pub fn around(fraction: [f32; 3], voxels: [Voxel; 8]) -> Option<Self> {
        if voxels.iter().fold(0, |any, voxel| any | voxel.weight) == 0 {
            return None;
        }
        let along = fraction.map(|f| [1.0 - f, f]);
        let shares: [f32; 8] = std::array::from_fn(|i| along[0][i & 1] * along[1][i >> 1 & 1] * along[2][i >> 2]);
        let missing: f32 = (0..8).map(|i| if voxels[i].is_observed() { 0.0 } else { shares[i] }).sum();
        (missing <= MOST_MISSING).then_some(Self { voxels, fraction, shares })
    }

    /// The observed corner that has most to say of the point.
    pub fn nearest(&self) -> usize {
        let share = |i: usize| if self.voxels[i].is_observed() { self.shares[i] } else { 0.0 };
        (1..8).fold(0, |best, i| if share(i) > share(best) { i } else { best })
    }

    /// Distance in voxels of this scale, and weight. With all eight observed, trilinear; with fewer, the observed ones are continued to
    /// the point along the gradient between them, so that a plane stays where it is. Between two surfaces, what the nearest one says.
    #[inline]
    pub fn interpolate(&self) -> (f32, f32) {
        let observed = self.voxels.map(Voxel::is_observed);
        let values = self.voxels.map(Voxel::distance_in_voxels);
        let (low, high) = (0..8).filter(|&i| observed[i]).fold((f32::MAX, f32::MIN), |(l, h), i| (l.min(values[i]), h.max(values[i])));
        if high - low > ONE_SURFACE {
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
        let onward = |i: usize| (0..3).map(|k| gradient[k] * (self.fraction[k] - (i >> k & 1) as f32)).sum::<f32>();
        let known = mean(&observed.map(|o| f32::from(u8::from(o))));
        let continued = std::array::from_fn(|i| if observed[i] { values[i] + onward(i) } else { 0.0 });
        // Those that were not observed weigh nothing.
        (mean(&continued) / known, mean(&weights) / known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::{DISTANCE_STEPS, WEIGHT_ONE};
    use proptest::prelude::*;

    /// The plane through the point `fraction` at `distance` voxels with `normal`, at the corners for whose bit `is_there`.
    fn plane(fraction: [f32; 3], distance: f32, normal: [f32; 3], is_there: u8) -> Option<(f32, f32)> {
        let voxels = std::array::from_fn(|i| {
            let at: f32 = (0..3).map(|k| normal[k] * ((i >> k & 1) as f32 - fraction[k])).sum();
            let steps = ((distance + at) * DISTANCE_STEPS).round() as i16;
            if is_there >> i & 1 == 1 { Voxel { distance: steps, weight: 3 * WEIGHT_ONE } } else { Voxel::default() }
        });
        Corners::around(fraction, voxels).map(|corners| corners.interpolate())
    }

    proptest! {
        #[test]
        fn a_plane_stays_where_it_is_and_is_known_where_enough_of_it_is(
            fraction in prop::array::uniform3(0f32..1.0), distance in -1f32..1.0, turn in prop::array::uniform2(-3f32..3.0), is_there in any::<u8>(),
        ) {
            let normal = [turn[0].cos() * turn[1].cos(), turn[0].sin() * turn[1].cos(), turn[1].sin()];
            let share = |i: &usize| (0..3).map(|k| if i >> k & 1 == 1 { fraction[k] } else { 1.0 - fraction[k] }).product::<f32>();
            let known: f32 = (0..8).filter(|i| is_there >> i & 1 == 1).map(|i| share(&i)).sum();
            prop_assume!((1.0 - MOST_MISSING - known).abs() > 1e-4);
            let found = plane(fraction, distance, normal, is_there);
            prop_assert_eq!(found.is_some(), known > 1.0 - MOST_MISSING);
            let pairs = |k: usize| (0..8u32).any(|i| i >> k & 1 == 0 && is_there >> i & 1 == 1 && is_there >> (i | 1 << k) & 1 == 1);
            if let Some((found, weight)) = found {
                prop_assert!((weight - f32::from(3 * WEIGHT_ONE)).abs() < 1e-3);
                // Along an axis along which no two neighbours are known, nothing tells how the distance changes.
                prop_assert!((found - distance).abs() < if (0..3).all(pairs) { 2e-3 } else { 0.75 }, "{} instead of {}", found, distance);
            }
        }
    }

    #[test]
    fn between_two_surfaces_nothing_is_interpolated() {
        let side = |i: usize| Voxel { distance: (if i & 1 == 0 { -1.25 } else { 1.5 } * DISTANCE_STEPS) as i16, weight: WEIGHT_ONE };
        let between = |first: Voxel| {
            let corners = Corners::around([0.3, 0.4, 0.4], std::array::from_fn(|i| if i == 0 { first } else { side(i) }));
            corners.map(|corners| corners.interpolate())
        };
        assert_eq!(between(Voxel { distance: -2048, weight: 32 }), Some((-1.0, 32.0)));
        assert_eq!(between(Voxel::default()), Some((-1.25, f32::from(WEIGHT_ONE))), "the next one is on the same side");
    }
}
