//! The sphere.

use super::maths::{MISS, Vec3};
use std::f64::consts::{PI, TAU};

/// A sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre, world frame, metres.
    pub centre: Vec3,
    /// Radius, metres.
    pub radius: f64,
}

impl Sphere {
    /// A sphere around `centre`.
    pub fn new(centre: [f64; 3], radius: f64) -> Self {
        Self { centre: centre.into(), radius }
    }

    #[inline(always)]
    pub(crate) fn distance(&self, p: &Vec3) -> f64 {
        (p - self.centre).norm() - self.radius
    }

    /// Computed from the projection of the centre on the line, which is accurate for distant origins, too.
    #[inline(always)]
    pub(crate) fn interval(&self, origin: &Vec3, direction: &Vec3) -> (f64, f64) {
        let to = self.centre - origin;
        let along = to.dot(direction);
        let miss = to - direction * along;
        let half2 = self.radius * self.radius - miss.dot(&miss);
        let half = half2.abs().sqrt();
        if half2 >= 0.0 { (along - half, along + half) } else { MISS }
    }

    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        let r = Vec3::repeat(self.radius);
        (self.centre - r, self.centre + r)
    }

    pub(crate) fn area(&self) -> f64 {
        4.0 * PI * self.radius * self.radius
    }

    pub(crate) fn surface_point(&self, u: f64, v: f64, _w: f64) -> Vec3 {
        let z = 2.0 * u - 1.0;
        let rho = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (TAU * v).sin_cos();
        self.centre + Vec3::new(rho * cos, rho * sin, z) * self.radius
    }

    pub(crate) fn parameters(&self) -> [f64; 8] {
        [self.centre.x, self.centre.y, self.centre.z, self.radius, 0.0, 0.0, 0.0, 0.0]
    }
}
