//! The capsule: a cylinder with round ends.

use super::cuboid::slab;
use super::cylinder::circle;
use super::maths::{Vec3, basis, larger, smaller};
use super::{Cylinder, Sphere};
use std::f64::consts::TAU;

/// All points within a radius of a segment: rails, branches, bars.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// Centre of the segment, world frame, metres.
    pub centre: Vec3,
    /// Unit vector along the segment.
    pub axis: Vec3,
    /// Half of the segment's length, metres.
    pub half_length: f64,
    /// Radius, metres.
    pub radius: f64,
}

impl Capsule {
    /// A capsule around the segment from `a` to `b`; a sphere when they coincide.
    pub fn between(a: [f64; 3], b: [f64; 3], radius: f64) -> Self {
        let Cylinder { centre, axis, half_length, radius } = Cylinder::between(a, b, radius);
        Self { centre, axis, half_length, radius }
    }

    /// The point of the segment that is nearest to `p`.
    #[inline(always)]
    pub(crate) fn foot(&self, p: &Vec3) -> Vec3 {
        let along = (p - self.centre).dot(&self.axis).clamp(-self.half_length, self.half_length);
        self.centre + self.axis * along
    }

    #[inline(always)]
    pub(crate) fn distance(&self, p: &Vec3) -> f64 {
        (p - self.foot(p)).norm() - self.radius
    }

    /// The capsule is convex and the union of its three parts: the interval is from the first entry to the last exit.
    #[inline(always)]
    pub(crate) fn interval(&self, origin: &Vec3, direction: &Vec3) -> (f64, f64) {
        let o = origin - self.centre;
        let (o_axis, d_axis) = (o.dot(&self.axis), direction.dot(&self.axis));
        let (o_flat, d_flat) = (o - self.axis * o_axis, direction - self.axis * d_axis);
        let side = circle(&o_flat, &d_flat, self.radius);
        let ends = slab(o_axis, d_axis, self.half_length);
        let (enter, exit) = (larger(side.0, ends.0), smaller(side.1, ends.1));
        let hit = enter <= exit;
        let tube = (if hit { enter } else { f64::INFINITY }, if hit { exit } else { f64::NEG_INFINITY });
        let reach = self.axis * self.half_length;
        let a = Sphere { centre: self.centre - reach, radius: self.radius }.interval(origin, direction);
        let b = Sphere { centre: self.centre + reach, radius: self.radius }.interval(origin, direction);
        (smaller(tube.0, smaller(a.0, b.0)), larger(tube.1, larger(a.1, b.1)))
    }

    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        let reach = self.axis.abs() * self.half_length + Vec3::repeat(self.radius);
        (self.centre - reach, self.centre + reach)
    }

    pub(crate) fn area(&self) -> f64 {
        2.0 * TAU * self.radius * (self.half_length + self.radius)
    }

    /// By Archimedes' theorem the area of a sphere is uniform along its axis like that of a cylinder, so one coordinate samples both.
    pub(crate) fn surface_point(&self, u: f64, v: f64, _w: f64) -> Vec3 {
        let (a, b) = basis(&self.axis);
        let (sin, cos) = (TAU * u).sin_cos();
        let along = (2.0 * v - 1.0) * (self.half_length + self.radius);
        let beyond = (along.abs() - self.half_length).max(0.0) / self.radius;
        let rho = self.radius * (1.0 - beyond * beyond).max(0.0).sqrt();
        self.centre + (a * cos + b * sin) * rho + self.axis * along
    }

    pub(crate) fn parameters(&self) -> [f64; 8] {
        let (c, a) = (self.centre, self.axis);
        [c.x, c.y, c.z, a.x, a.y, a.z, self.half_length, self.radius]
    }
}
