//! The box, rotated about the vertical.

use super::maths::{Vec3, larger, reciprocal, smaller};

/// A box rotated about the vertical through its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cuboid {
    /// Centre, world frame, metres.
    pub centre: Vec3,
    /// Half of the edge lengths along the box's own axes, metres.
    pub half: Vec3,
    /// Cosine and sine of the rotation.
    pub(crate) turn: (f64, f64),
}

impl Cuboid {
    /// The axis-aligned box with these two corners, in any order.
    pub fn between(a: [f64; 3], b: [f64; 3]) -> Self {
        let (a, b) = (Vec3::from(a), Vec3::from(b));
        Self { centre: (a + b) / 2.0, half: (b - a).abs() / 2.0, turn: (1.0, 0.0) }
    }

    /// A box around `centre` with edges of length `size`, rotated counter-clockwise by `yaw` radians.
    pub fn turned(centre: [f64; 3], size: [f64; 3], yaw: f64) -> Self {
        let (sin, cos) = yaw.sin_cos();
        Self { centre: centre.into(), half: Vec3::from(size) / 2.0, turn: (cos, sin) }
    }

    /// A direction in world coordinates, in the axes of the box.
    #[inline(always)]
    pub(crate) fn to_local(self, v: &Vec3) -> Vec3 {
        let (cos, sin) = self.turn;
        Vec3::new(cos * v.x + sin * v.y, cos * v.y - sin * v.x, v.z)
    }

    /// The inverse of [`to_local`](Self::to_local).
    #[inline(always)]
    pub(crate) fn to_world(self, v: &Vec3) -> Vec3 {
        let (cos, sin) = self.turn;
        Vec3::new(cos * v.x - sin * v.y, cos * v.y + sin * v.x, v.z)
    }

    #[inline(always)]
    pub(crate) fn distance(&self, p: &Vec3) -> f64 {
        let q = self.to_local(&(p - self.centre)).abs() - self.half;
        let outside = Vec3::new(q.x.max(0.0), q.y.max(0.0), q.z.max(0.0)).norm();
        outside + q.x.max(q.y).max(q.z).min(0.0)
    }

    #[inline(always)]
    pub(crate) fn interval(&self, origin: &Vec3, direction: &Vec3) -> (f64, f64) {
        let o = self.to_local(&(origin - self.centre));
        let d = self.to_local(direction);
        let (x, y, z) = (slab(o.x, d.x, self.half.x), slab(o.y, d.y, self.half.y), slab(o.z, d.z, self.half.z));
        let enter = larger(larger(x.0, y.0), z.0);
        let exit = smaller(smaller(x.1, y.1), z.1);
        let hit = enter <= exit;
        (if hit { enter } else { f64::INFINITY }, if hit { exit } else { f64::NEG_INFINITY })
    }

    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        let (cos, sin) = (self.turn.0.abs(), self.turn.1.abs());
        let h = self.half;
        let reach = Vec3::new(cos * h.x + sin * h.y, sin * h.x + cos * h.y, h.z);
        (self.centre - reach, self.centre + reach)
    }

    pub(crate) fn area(&self) -> f64 {
        let h = self.half;
        8.0 * (h.x * h.y + h.y * h.z + h.z * h.x)
    }

    pub(crate) fn surface_point(&self, u: f64, v: f64, w: f64) -> Vec3 {
        let h = self.half;
        // The pair of faces across x, y or z is chosen by area; the rest of the number chooses the side.
        let shares = [h.y * h.z, h.z * h.x, h.x * h.y];
        let mut remainder = w * shares.iter().sum::<f64>();
        let mut axis = 0;
        while axis < 2 && remainder >= shares[axis] {
            remainder -= shares[axis];
            axis += 1;
        }
        let side = if remainder < shares[axis] / 2.0 { -1.0 } else { 1.0 };
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut local = Vec3::zeros();
        local[axis] = side * h[axis];
        local[a] = (2.0 * u - 1.0) * h[a];
        local[b] = (2.0 * v - 1.0) * h[b];
        self.centre + self.to_world(&local)
    }

    pub(crate) fn parameters(&self) -> [f64; 8] {
        let (c, h) = (self.centre, self.half);
        [c.x, c.y, c.z, h.x, h.y, h.z, self.turn.0, self.turn.1]
    }
}

/// The interval in which a coordinate `o + t * d` is within -half..half.
#[inline(always)]
pub(crate) fn slab(o: f64, d: f64, half: f64) -> (f64, f64) {
    let inverse = reciprocal(d);
    let (a, b) = ((-half - o) * inverse, (half - o) * inverse);
    (smaller(a, b), larger(a, b))
}
