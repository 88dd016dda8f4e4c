//! The finite cylinder.

use super::cuboid::slab;
use super::maths::{MISS, Vec3, basis, larger, smaller};
use std::f64::consts::TAU;

/// A cylinder with flat ends about any axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Centre of the axis, world frame, metres.
    pub centre: Vec3,
    /// Unit vector along the axis.
    pub axis: Vec3,
    /// Half of the length along the axis, metres.
    pub half_length: f64,
    /// Radius, metres.
    pub radius: f64,
}

impl Cylinder {
    /// An upright cylinder with the centre of its base at `foot`.
    pub fn upright(foot: [f64; 3], height: f64, radius: f64) -> Self {
        Self { centre: Vec3::from(foot) + Vec3::z() * (height / 2.0), axis: Vec3::z(), half_length: height / 2.0, radius }
    }

    /// A cylinder between the centres `a` and `b` of its ends; upright and of zero length when they coincide.
    pub fn between(a: [f64; 3], b: [f64; 3], radius: f64) -> Self {
        let (a, b) = (Vec3::from(a), Vec3::from(b));
        let axis = (b - a).try_normalize(1e-12).unwrap_or_else(Vec3::z);
        Self { centre: (a + b) / 2.0, axis, half_length: (b - a).norm() / 2.0, radius }
    }

    #[inline(always)]
    pub(crate) fn distance(&self, p: &Vec3) -> f64 {
        let to = p - self.centre;
        let along = to.dot(&self.axis);
        let side = (to - self.axis * along).norm() - self.radius;
        let end = along.abs() - self.half_length;
        let outside = side.max(0.0).hypot(end.max(0.0));
        outside + side.max(end).min(0.0)
    }

    #[inline(always)]
    pub(crate) fn interval(&self, origin: &Vec3, direction: &Vec3) -> (f64, f64) {
        let o = origin - self.centre;
        let (o_axis, d_axis) = (o.dot(&self.axis), direction.dot(&self.axis));
        let (o_flat, d_flat) = (o - self.axis * o_axis, direction - self.axis * d_axis);
        let side = circle(&o_flat, &d_flat, self.radius);
        let ends = slab(o_axis, d_axis, self.half_length);
        let (enter, exit) = (larger(side.0, ends.0), smaller(side.1, ends.1));
        let hit = enter <= exit;
        (if hit { enter } else { f64::INFINITY }, if hit { exit } else { f64::NEG_INFINITY })
    }

    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        let reach = self.axis.map(|a| a.abs() * self.half_length + (1.0 - a * a).max(0.0).sqrt() * self.radius);
        (self.centre - reach, self.centre + reach)
    }

    pub(crate) fn area(&self) -> f64 {
        TAU * self.radius * (2.0 * self.half_length + self.radius)
    }

    pub(crate) fn surface_point(&self, u: f64, v: f64, w: f64) -> Vec3 {
        let (a, b) = basis(&self.axis);
        let (sin, cos) = (TAU * u).sin_cos();
        let around = a * cos + b * sin;
        let side = 2.0 * self.half_length / (2.0 * self.half_length + self.radius);
        if w < side {
            return self.centre + around * self.radius + self.axis * ((2.0 * v - 1.0) * self.half_length);
        }
        let end = if w - side < (1.0 - side) / 2.0 { -1.0 } else { 1.0 };
        self.centre + around * (self.radius * v.sqrt()) + self.axis * (end * self.half_length)
    }

    pub(crate) fn parameters(&self) -> [f64; 8] {
        let (c, a) = (self.centre, self.axis);
        [c.x, c.y, c.z, a.x, a.y, a.z, self.half_length, self.radius]
    }
}

/// The interval in which a line is within `radius` of an axis, from its origin and direction perpendicular to the axis.
#[inline(always)]
pub(crate) fn circle(o: &Vec3, d: &Vec3, radius: f64) -> (f64, f64) {
    let speed2 = d.dot(d);
    // A line parallel to the axis is always or never inside: with a tiny speed both ends are very far away.
    let per_speed2 = 1.0 / larger(speed2, 1e-24);
    let foot = -o.dot(d) * per_speed2;
    let nearest = o + d * foot;
    let half2 = radius * radius - nearest.dot(&nearest);
    let half = (half2.abs() * per_speed2).sqrt();
    if half2 >= 0.0 { (foot - half, foot + half) } else { MISS }
}
