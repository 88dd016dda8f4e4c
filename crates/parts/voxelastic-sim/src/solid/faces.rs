//! The smooth faces of a solid. A point is outside of a convex solid if it is in front of at least one of them.

use super::Solid;
use super::maths::{Vec3, basis};

/// A smooth face of a solid.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Face {
    /// A plane with unit normal and offset.
    Plane(Vec3, f64),
    /// The side of a cylinder: a point of the axis, its unit vector, and the radius.
    CylinderSide(Vec3, Vec3, f64),
    /// A sphere: centre and radius.
    Sphere(Vec3, f64),
    /// The surface of a capsule.
    Capsule(super::Capsule),
}

impl Face {
    /// Signed distance of `p` in front of the face, and the unit gradient there.
    pub(crate) fn eval(&self, p: &Vec3) -> (f64, Vec3) {
        let around = |to: Vec3, radius: f64, fallback: Vec3| {
            let length = to.norm();
            // On the axis all directions are equivalent.
            (length - radius, if length > 1e-12 { to / length } else { fallback })
        };
        match self {
            Face::Plane(normal, offset) => (normal.dot(p) - offset, *normal),
            Face::CylinderSide(centre, axis, radius) => {
                let to = p - centre;
                around(to - axis * to.dot(axis), *radius, basis(axis).0)
            }
            Face::Sphere(centre, radius) => around(p - centre, *radius, Vec3::z()),
            Face::Capsule(capsule) => around(p - capsule.foot(p), capsule.radius, basis(&capsule.axis).0),
        }
    }
}

impl Solid {
    /// All faces of the solid.
    pub(crate) fn faces(&self) -> impl Iterator<Item = Face> + use<> {
        let solid = *self;
        let count = match solid {
            Solid::Cuboid(_) => 6,
            Solid::Cylinder(_) => 3,
            Solid::Sphere(_) | Solid::Capsule(_) | Solid::HalfSpace(_) => 1,
        };
        (0..count).map(move |k| solid.face(k))
    }

    fn face(&self, k: usize) -> Face {
        let end = |centre: &Vec3, axis: Vec3, half: f64| Face::Plane(axis, axis.dot(centre) + half);
        match self {
            Solid::Cuboid(b) => {
                let mut axis = Vec3::zeros();
                axis[k / 2] = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
                end(&b.centre, b.to_world(&axis), b.half[k / 2])
            }
            Solid::Cylinder(c) => match k {
                0 => Face::CylinderSide(c.centre, c.axis, c.radius),
                1 => end(&c.centre, c.axis, c.half_length),
                _ => end(&c.centre, -c.axis, c.half_length),
            },
            Solid::Sphere(s) => Face::Sphere(s.centre, s.radius),
            Solid::Capsule(c) => Face::Capsule(*c),
            Solid::HalfSpace(h) => Face::Plane(h.normal, h.offset),
        }
    }
}
