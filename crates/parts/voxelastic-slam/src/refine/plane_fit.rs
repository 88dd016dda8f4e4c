//! A plane through surfels of one cube, by robust least squares.

use super::settings::Round;
use nalgebra::{Matrix3, Vector3};
use voxelastic::geometry::smallest_eigenvector;

/// A surfel where a pose puts it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    /// Mean, relative to the centre of the cube at the root.
    pub(super) point: Vector3<f64>,
    /// Unit normal towards the sensor, in the map frame; zero for a line.
    pub(super) normal: Vector3<f64>,
    /// What it counts.
    pub(super) weight: f64,
    pub(super) scan: u32,
    /// Its number within the scan.
    pub(super) surfel: u32,
}

/// A plane, in the same coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) centre: Vector3<f64>,
    pub(super) normal: Vector3<f64>,
    /// Variance of the surfels on it across it, metres squared.
    pub(super) variance: f64,
}

/// Steps of the robust fit.
const STEPS: usize = 4;
/// Cosine of the largest angle between a plane and a surfel on it.
const LEAST_COSINE: f64 = 0.92;
/// The smaller spread of a plane's surfels within it, in edges of the cube (standard deviations): less does not hold its direction.
const LEAST_WIDTH: f64 = 0.08;
/// The share of the surfels in a cube that must lie on its plane.
const LEAST_SHARE: f64 = 0.6;
/// Surfels that a plane needs.
const LEAST_SURFELS: usize = 5;

impl Plane {
    /// The distance of a point from it, positive on the side of the sensor.
    pub(super) fn distance(&self, point: &Vector3<f64>) -> f64 {
        self.normal.dot(&(point - self.centre))
    }

    /// What a surfel with a normal counts for it, from 0 to 1.
    pub(super) fn trust(&self, placed: &Placed, gate: f64) -> f64 {
        if self.normal.dot(&placed.normal) < LEAST_COSINE { 0.0 } else { tukey(self.distance(&placed.point), gate) }
    }

    /// The plane through surfels of one side in a cube of edge `size`, if they are one.
    pub(super) fn through(surfels: &[Placed], size: f64, round: &Round) -> Option<Self> {
        if surfels.len() < LEAST_SURFELS {
            return None;
        }
        let mut plane = Self::first(surfels)?;
        for _ in 0..STEPS {
            plane = plane.next(surfels, size, round)?;
        }
        let (mut all, mut on, mut squares) = (0.0, 0.0, 0.0);
        for placed in surfels {
            let weight = placed.weight * plane.trust(placed, round.gate);
            (all, on) = (all + placed.weight, on + weight);
            squares += weight * plane.distance(&placed.point).powi(2);
        }
        let variance = squares / on;
        (on > LEAST_SHARE * all && variance < round.thickness * round.thickness).then_some(Self { variance, ..plane })
    }

    /// The mean normal, at the median distance along it.
    fn first(surfels: &[Placed]) -> Option<Self> {
        let normal = surfels.iter().map(|s| s.weight * s.normal).sum::<Vector3<f64>>().try_normalize(1e-9)?;
        let mut along: Vec<f64> = surfels.iter().map(|s| normal.dot(&s.point)).collect();
        let middle = along.len() / 2;
        let (_, median, _) = along.select_nth_unstable_by(middle, f64::total_cmp);
        let mean = surfels.iter().map(|s| s.point).sum::<Vector3<f64>>() / surfels.len() as f64;
        Some(Self { centre: mean + normal * (*median - normal.dot(&mean)), normal, variance: 0.0 })
    }

    /// The plane that fits best the surfels that lie near this one.
    fn next(&self, surfels: &[Placed], size: f64, round: &Round) -> Option<Self> {
        let (mut weight, mut sum, mut squares) = (0.0, Vector3::zeros(), Matrix3::zeros());
        for placed in surfels {
            let w = placed.weight * self.trust(placed, round.gate);
            let p = placed.point - self.centre;
            (weight, sum, squares) = (weight + w, sum + w * p, squares + w * p * p.transpose());
        }
        if weight <= 0.0 {
            return None;
        }
        let mean = sum / weight;
        let c = squares / weight - mean * mean.transpose();
        let (values, normal) = smallest_eigenvector([c.m11, c.m12, c.m13, c.m22, c.m23, c.m33]);
        let normal = Vector3::from(normal.filter(|_| values[1] > (LEAST_WIDTH * size).powi(2))?);
        Some(Self { centre: self.centre + mean, normal: if normal.dot(&self.normal) < 0.0 { -normal } else { normal }, variance: 0.0 })
    }
}

/// Tukey's weight: 1 at no distance, 0 from the gate on.
pub(super) fn tukey(distance: f64, gate: f64) -> f64 {
    let share = 1.0 - (distance / gate).powi(2);
    if share > 0.0 { share * share } else { 0.0 }
}
