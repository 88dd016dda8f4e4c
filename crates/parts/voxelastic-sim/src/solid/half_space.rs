//! The half space.

use super::maths::{MISS, Vec3};

/// All points with `normal . p <= offset`: the ground, a rock face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Unit normal of the plane, pointing out of the solid.
    pub normal: Vec3,
    /// Distance of the plane from the world's origin along the normal, metres.
    pub offset: f64,
}

impl HalfSpace {
    /// Everything below `height`.
    pub fn below(height: f64) -> Self {
        Self { normal: Vec3::z(), offset: height }
    }

    #[inline(always)]
    pub(crate) fn distance(&self, p: &Vec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    #[inline(always)]
    pub(crate) fn interval(&self, origin: &Vec3, direction: &Vec3) -> (f64, f64) {
        let height = self.distance(origin);
        let slope = self.normal.dot(direction);
        let t = -height * super::maths::reciprocal(slope);
        let level = slope.abs() < 1e-12;
        let is_descending = if level { height <= 0.0 } else { slope < 0.0 };
        if level && !is_descending {
            MISS
        } else if is_descending {
            (if level { f64::NEG_INFINITY } else { t }, f64::INFINITY)
        } else {
            (f64::NEG_INFINITY, t)
        }
    }

    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        (Vec3::repeat(f64::NEG_INFINITY), Vec3::repeat(f64::INFINITY))
    }

    pub(crate) fn area(&self) -> f64 {
        f64::INFINITY
    }

    pub(crate) fn surface_point(&self, _u: f64, _v: f64, _w: f64) -> Vec3 {
        self.normal * self.offset
    }

    pub(crate) fn parameters(&self) -> [f64; 8] {
        [self.normal.x, self.normal.y, self.normal.z, self.offset, 0.0, 0.0, 0.0, 0.0]
    }
}
