//! A plane through neighbouring returns.

use super::neighbours::{MOST, Neighbours};
use crate::geometry::smallest_eigenvectors;
use crate::sensor::normals::NormalSettings;
use crate::simd::{Kernel, dispatch};

/// Fewer neighbours make no plane.
const LEAST: usize = 6;
/// Planes that are fitted together.
const LANES: usize = 8;
/// How many times a return counts among the neighbours of neighbours: of some 200 that are counted, as much is known as of 36 that are counted once.
const REPEATS: f32 = 5.5;
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

/// Number of returns, sum of their offsets from a point, and sums of the products of these: xx xy xz yy yz zz.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    count: f32,
    sum: [f32; 3],
    products: [f32; 6],
}

/// The same for one plane a lane.
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

    /// Adds moments to each lane that are about a point `shift` away from the lane's.
    #[inline(always)]
    fn add_moments(&mut self, moments: &Self, shift: &[[f32; LANES]; 3]) {
        for (sum, (product, [a, b])) in self.products.iter_mut().zip(moments.products.iter().zip(PAIRS)) {
            for l in 0..LANES {
                let cross = moments.sum[a][l] * shift[b][l] + moments.sum[b][l] * shift[a][l];
                sum[l] += product[l] + cross + moments.count[l] * shift[a][l] * shift[b][l];
            }
        }
        for ((sum, of), shift) in self.sum.iter_mut().zip(&moments.sum).zip(shift) {
            (0..LANES).for_each(|l| sum[l] += of[l] + moments.count[l] * shift[l]);
        }
        (0..LANES).for_each(|l| self.count[l] += moments.count[l]);
    }

    /// The planes; offsets are from `origins`. Of the returns that were counted, each stands for `repeats`.
    #[inline(always)]
    fn planes(&self, origins: &[[f32; 3]], repeats: f32, planes: &mut [Plane]) {
        let per_count = self.count.map(|count| 1.0 / if count > 0.0 { count } else { 1.0 });
        let mean: [[f32; LANES]; 3] = std::array::from_fn(|k| std::array::from_fn(|l| self.sum[k][l] * per_count[l]));
        let central = |i: usize, a: usize, b: usize| -> [f64; LANES] {
            std::array::from_fn(|l| f64::from(self.products[i][l]) - f64::from(self.sum[a][l]) * f64::from(mean[b][l]))
        };
        let covariance = [central(0, 0, 0), central(1, 0, 1), central(2, 0, 2), central(3, 1, 1), central(4, 1, 2), central(5, 2, 2)];
        let ([least, middle], normals) = smallest_eigenvectors(&covariance);
        for (l, (plane, origin)) in planes.iter_mut().zip(origins).enumerate() {
            let count = self.count[l] / repeats;
            let is_plane = count >= LEAST as f32 && (0..3).any(|k| normals[k][l] != 0.0);
            *plane = Plane::default();
            if is_plane {
                plane.centre = std::array::from_fn(|k| origin[k] + mean[k][l]);
                plane.normal = std::array::from_fn(|k| normals[k][l] as f32);
                plane.roughness = (least[l].max(0.0) / f64::from(repeats * (count - 3.0))).sqrt() as f32;
                plane.breadth = (middle[l].max(0.0) / f64::from(repeats)).sqrt() as f32;
            }
        }
    }
}

/// Fits planes to the neighbours of the returns from `first` on, as many as there is room for, and keeps the moments of these.
pub(super) fn fit(points: &[[f32; 3]], neighbours: &Neighbours, first: usize, planes: &mut [Plane], moments: &mut [Moments]) {
    dispatch(Fit { points, neighbours, first, planes, moments });
}

struct Fit<'a> {
    points: &'a [[f32; 3]],
    neighbours: &'a Neighbours,
    first: usize,
    planes: &'a mut [Plane],
    moments: &'a mut [Moments],
}

impl Kernel for Fit<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { points, neighbours, first, planes, moments } = self;
        let origins = points[first..].chunks(LANES);
        for (step, ((planes, moments), origins)) in planes.chunks_mut(LANES).zip(moments.chunks_mut(LANES)).zip(origins).enumerate() {
            let mut lanes = MomentLanes::NONE;
            let mut offsets = [[[0.0; LANES]; 3]; MOST];
            for l in 0..planes.len() {
                let (list, origin) = (neighbours.of(first + step * LANES + l), origins[l]);
                lanes.count[l] = list.len() as f32;
                for (offset, &j) in offsets.iter_mut().zip(list) {
                    let q = points[j as usize];
                    (0..3).for_each(|k| offset[k][l] = q[k] - origin[k]);
                }
            }
            offsets.iter().for_each(|offset| lanes.add(offset));
            lanes.planes(&origins[..planes.len()], 1.0, planes);
            for (l, of) in moments.iter_mut().enumerate() {
                *of = Moments { count: lanes.count[l], sum: lanes.sum.map(|sum| sum[l]), products: lanes.products.map(|sum| sum[l]) };
            }
        }
    }
}

/// Fits planes to the neighbours of the neighbours of some returns, each as often as it is one's: those in the middle count more.
pub(super) fn fit_wider(points: &[[f32; 3]], neighbours: &Neighbours, moments: &[Moments], which: &[u32], planes: &mut [Plane]) {
    dispatch(FitWider { points, neighbours, moments, which, planes });
}

struct FitWider<'a> {
    points: &'a [[f32; 3]],
    neighbours: &'a Neighbours,
    moments: &'a [Moments],
    which: &'a [u32],
    planes: &'a mut [Plane],
}

impl Kernel for FitWider<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { points, neighbours, moments, which, planes } = self;
        for (which, planes) in which.chunks(LANES).zip(planes.chunks_mut(LANES)) {
            let mut origins = [[0.0; 3]; LANES];
            let mut lanes = MomentLanes::NONE;
            for (origin, &i) in origins.iter_mut().zip(which) {
                *origin = points[i as usize];
            }
            for n in 0..MOST {
                let (mut of, mut shift) = (MomentLanes::NONE, [[0.0; LANES]; 3]);
                for (l, (&i, origin)) in which.iter().zip(&origins).enumerate() {
                    let Some(&j) = neighbours.of(i as usize).get(n) else { continue };
                    let (from, q) = (&moments[j as usize], points[j as usize]);
                    of.count[l] = from.count;
                    (0..3).for_each(|k| (of.sum[k][l], shift[k][l]) = (from.sum[k], q[k] - origin[k]));
                    (0..6).for_each(|k| of.products[k][l] = from.products[k]);
                }
                lanes.add_moments(&of, &shift);
            }
            lanes.planes(&origins[..planes.len()], REPEATS, planes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::neighbours::found;
    use super::*;
    use crate::geometry::smallest_eigenvector;
    use proptest::prelude::*;

    /// The plane with the least squares of the distances of `list`, its roughness and breadth if each return counts as `repeats`, and how clearly it is one.
    fn slow(points: &[[f32; 3]], list: &[u32], repeats: f64) -> (Plane, f64) {
        let all: Vec<[f64; 3]> = list.iter().map(|&j| points[j as usize].map(f64::from)).collect();
        let count = all.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|k| all.iter().map(|p| p[k]).sum::<f64>() / count);
        let product = |a: usize, b: usize| all.iter().map(|p| (p[a] - mean[a]) * (p[b] - mean[b])).sum::<f64>();
        let (values, normal) = smallest_eigenvector([product(0, 0), product(0, 1), product(0, 2), product(1, 1), product(1, 2), product(2, 2)]);
        let plane = Plane {
            centre: mean.map(|c| c as f32),
            normal: normal.unwrap_or_default().map(|c| c as f32),
            roughness: (values[0].max(0.0) / (count - 3.0 * repeats)).sqrt() as f32,
            breadth: (values[1] / repeats).sqrt() as f32,
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
            let mut moments = vec![Moments::default(); points.len()];
            fit(&points, &neighbours, 0, &mut planes, &mut moments);
            fit_wider(&points, &neighbours, &moments, &(0..points.len() as u32).collect::<Vec<_>>(), &mut wider);
            for i in 0..points.len() {
                let of = neighbours.of(i);
                let of_neighbours: Vec<u32> = of.iter().flat_map(|&j| neighbours.of(j as usize)).copied().collect();
                for (plane, list, repeats) in [(&planes[i], of, 1.0), (&wider[i], &of_neighbours[..], f64::from(REPEATS))] {
                    if list.is_empty() {
                        prop_assert_eq!(plane.normal, [0.0; 3]);
                        continue;
                    }
                    // Only where there is a plane.
                    let (expected, clearness) = slow(&points, list, repeats);
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
