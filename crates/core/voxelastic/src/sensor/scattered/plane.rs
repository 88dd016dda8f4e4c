//! A plane through neighbouring returns.

use super::neighbours::Neighbours;
use crate::geometry::smallest_eigenvectors;
use crate::sensor::normals::NormalSettings;
use crate::simd::{Kernel, dispatch};

/// Fewer neighbours make no plane.
const LEAST: usize = 6;
/// Planes that are fitted together.
const LANES: usize = 8;
/// The products of coordinates that moments have.
const PAIRS: [[usize; 2]; 6] = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];

/// A plane through neighbouring returns.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Plane {
    pub centre: [f32; 3],
    /// Unit normal towards the sensor.
    pub normal: [f32; 3],
    /// Standard deviation of the neighbours along the normal, metres.
    pub roughness: f32,
    /// Extent of the neighbours across the plane's narrow direction: root of the sum of squares, metres.
    pub breadth: f32,
    pub is_accepted: bool,
}

impl Plane {
    /// Decides whether the plane can be trusted: its neighbours deviate from it no more than noise and the allowed roughness explain, and its direction is certain.
    pub fn accept(&mut self, noise: f32, settings: &NormalSettings) {
        let uncertainty = self.roughness.max(noise) / self.breadth.max(f32::MIN_POSITIVE);
        self.is_accepted = self.is_flat(noise, settings) && uncertainty <= settings.max_uncertainty;
    }

    /// Whether noise and the allowed roughness explain how much the neighbours deviate.
    pub fn is_flat(&self, noise: f32, settings: &NormalSettings) -> bool {
        /// Noise differs over a scan: a deviation larger than the usual one by this factor still counts as noise.
        const SLACK: f32 = 2.0;
        self.roughness <= (SLACK * noise).max(settings.roughness)
    }

    /// Turns the normal towards the position from which `p` was measured.
    pub fn face(&mut self, origin: [f32; 3], p: [f32; 3]) {
        if (0..3).map(|k| (origin[k] - p[k]) * self.normal[k]).sum::<f32>() < 0.0 {
            self.normal = self.normal.map(|c| -c);
        }
    }

    /// Distance of a point in standard deviations.
    pub fn misfit(&self, p: [f32; 3], noise: f32) -> f32 {
        let distance: f32 = (0..3).map(|k| (p[k] - self.centre[k]) * self.normal[k]).sum();
        distance.abs() / self.roughness.max(noise)
    }
}

/// Number of returns, sum of their offsets from a point, and sums of the products of these, xx xy xz yy yz zz, for one plane a lane.
struct MomentLanes {
    count: [f32; LANES],
    sum: [[f32; LANES]; 3],
    products: [[f32; LANES]; 6],
}

impl MomentLanes {
    const NONE: Self = Self { count: [0.0; LANES], sum: [[0.0; LANES]; 3], products: [[0.0; LANES]; 6] };

    /// Adds a return to each lane; lanes without one have no offset.
    #[inline(always)]
    fn add(&mut self, offset: &[[f32; LANES]; 3]) {
        for (sum, offset) in self.sum.iter_mut().zip(offset) {
            (0..LANES).for_each(|l| sum[l] += offset[l]);
        }
        for (sum, [a, b]) in self.products.iter_mut().zip(PAIRS) {
            (0..LANES).for_each(|l| sum[l] += offset[a][l] * offset[b][l]);
        }
    }

    /// The planes; offsets are from `origins`.
    #[inline(always)]
    fn planes(&self, origins: &[[f32; 3]], planes: &mut [Plane]) {
        let per_count = self.count.map(|count| 1.0 / if count > 0.0 { count } else { 1.0 });
        let mean: [[f32; LANES]; 3] = std::array::from_fn(|k| std::array::from_fn(|l| self.sum[k][l] * per_count[l]));
        let central = |i: usize, a: usize, b: usize| -> [f64; LANES] {
            std::array::from_fn(|l| f64::from(self.products[i][l]) - f64::from(self.sum[a][l]) * f64::from(mean[b][l]))
        };
        let covariance = std::array::from_fn(|i| central(i, PAIRS[i][0], PAIRS[i][1]));
        let ([least, middle], normals) = smallest_eigenvectors(&covariance);
        for (l, (plane, origin)) in planes.iter_mut().zip(origins).enumerate() {
            let count = self.count[l];
            let is_plane = count >= LEAST as f32 && (0..3).any(|k| normals[k][l] != 0.0);
            *plane = Plane::default();
            if is_plane {
                plane.centre = std::array::from_fn(|k| origin[k] + mean[k][l]);
                plane.normal = std::array::from_fn(|k| normals[k][l] as f32);
                plane.roughness = (least[l].max(0.0) / f64::from(count - 3.0)).sqrt() as f32;
                plane.breadth = middle[l].max(0.0).sqrt() as f32;
            }
        }
    }
}

/// Fits planes to the neighbours of the returns from `first` on, as many as there is room for.
pub(super) fn fit(points: &[[f32; 3]], neighbours: &Neighbours, first: usize, planes: &mut [Plane]) {
    let lists = |k: usize| neighbours.of(first + k);
    dispatch(Fit { points, origin: |k| points[first + k], lists, planes });
}

/// Fits planes to the neighbours of the neighbours of some returns.
pub(super) fn fit_wider(points: &[[f32; 3]], neighbours: &Neighbours, which: &[u32], planes: &mut [Plane]) {
    let (mut seen, mut all, mut ends) = (vec![u32::MAX; points.len()], Vec::new(), vec![0]);
    for &i in which {
        neighbours.of_neighbours(i, &mut seen, &mut all);
        ends.push(all.len());
    }
    let lists = |k: usize| &all[ends[k]..ends[k + 1]];
    dispatch(Fit { points, origin: |k| points[which[k] as usize], lists, planes });
}

/// Fits planes, several at once, to the returns that `lists` gives for each.
struct Fit<'a, O, L> {
    points: &'a [[f32; 3]],
    /// A point near the returns of a plane.
    origin: O,
    lists: L,
    planes: &'a mut [Plane],
}

impl<'a, O: Fn(usize) -> [f32; 3], L: Fn(usize) -> &'a [u32]> Kernel for Fit<'_, O, L> {
    #[inline(always)]
    fn run(self) {
        let Self { points, origin, lists, planes } = self;
        for (step, planes) in planes.chunks_mut(LANES).enumerate() {
            let (mut lanes, mut origins, mut of) = (MomentLanes::NONE, [[0.0; 3]; LANES], [&[][..]; LANES]);
            for l in 0..planes.len() {
                (origins[l], of[l]) = (origin(step * LANES + l), lists(step * LANES + l));
                lanes.count[l] = of[l].len() as f32;
            }
            for n in 0..of.iter().map(|list| list.len()).max().unwrap_or(0) {
                let mut offset = [[0.0; LANES]; 3];
                for (l, (list, origin)) in of.iter().zip(&origins).enumerate() {
                    if let Some(&j) = list.get(n) {
                        let q = points[j as usize];
                        (0..3).for_each(|k| offset[k][l] = q[k] - origin[k]);
                    }
                }
                lanes.add(&offset);
            }
            lanes.planes(&origins[..planes.len()], planes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::neighbours::found;
    use super::*;
    use crate::geometry::smallest_eigenvector;
    use proptest::prelude::*;

    /// The plane with the least squares of the distances of `list`, and how clearly it is one.
    fn slow(points: &[[f32; 3]], list: &[u32]) -> (Plane, f64) {
        let all: Vec<[f64; 3]> = list.iter().map(|&j| points[j as usize].map(f64::from)).collect();
        let count = all.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|k| all.iter().map(|p| p[k]).sum::<f64>() / count);
        let product = |a: usize, b: usize| all.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>();
        let (values, normal) = smallest_eigenvector([product(0, 0), product(0, 1), product(0, 2), product(1, 1), product(1, 2), product(2, 2)]);
        let plane = Plane {
            centre: mean.map(|c| c as f32),
            normal: normal.unwrap_or_default().map(|c| c as f32),
            roughness: (values[0].max(0.0) / (count - 3.0)).sqrt() as f32,
            breadth: values[1].sqrt() as f32,
            is_accepted: false,
        };
        (plane, values[1] / values[0].max(1e-9))
    }

    proptest! {
        #[test]
        fn they_have_the_least_squares_of_their_returns(
            points in prop::collection::vec(prop::array::uniform3(-1f32..1.0), 1..150),
            size in 0.1f32..5.0,
            flatness in 0.0f32..0.3,
            away in prop::array::uniform3(-50f32..50.0),
        ) {
            // Points near a slanted plane, far from the origin.
            let slanted = |p: &[f32; 3]| [away[0] + size * p[0], away[1] + size * p[1], away[2] + size * (flatness * p[2] + 0.5 * p[0] - 0.3 * p[1])];
            let (neighbours, points) = found(&points.iter().map(slanted).collect::<Vec<_>>());
            let (mut planes, mut wider) = (vec![Plane::default(); points.len()], vec![Plane::default(); points.len()]);
            fit(&points, &neighbours, 0, &mut planes);
            fit_wider(&points, &neighbours, &(0..points.len() as u32).collect::<Vec<_>>(), &mut wider);
            for i in 0..points.len() {
                let of = neighbours.of(i);
                let of_neighbours: std::collections::BTreeSet<u32> = of.iter().flat_map(|&j| neighbours.of(j as usize)).copied().collect();
                let of_neighbours: Vec<u32> = of_neighbours.into_iter().collect();
                for (plane, list) in [(&planes[i], of), (&wider[i], &of_neighbours[..])] {
                    if list.is_empty() {
                        prop_assert_eq!(plane.normal, [0.0; 3]);
                        continue;
                    }
                    // Only where there is a plane.
                    let (expected, clearness) = slow(&points, list);
                    if clearness > 4.0 {
                        let tolerance = 2e-4 * size;
                        prop_assert!((0..3).all(|k| (plane.centre[k] - expected.centre[k]).abs() < tolerance), "{plane:?} is not {expected:?}");
                        let cosine: f32 = (0..3).map(|k| expected.normal[k] * plane.normal[k]).sum();
                        prop_assert!(cosine.abs() > 1.0 - 1e-4, "{plane:?} is not {expected:?}");
                        prop_assert!((plane.roughness - expected.roughness).abs() < 10.0 * tolerance, "{plane:?} is not {expected:?}");
                        prop_assert!((plane.breadth - expected.breadth).abs() < 10.0 * tolerance, "{plane:?} is not {expected:?}");
                    }
                }
            }
        }
    }
}
