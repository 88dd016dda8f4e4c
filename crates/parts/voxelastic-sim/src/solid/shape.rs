//! A solid of any shape.

use super::{Capsule, Cuboid, Cylinder, HalfSpace, Sphere, Vec3};

/// A convex solid in the world frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solid {
    /// A box, rotated about the vertical.
    Cuboid(Cuboid),
    /// A finite cylinder about any axis.
    Cylinder(Cylinder),
    /// A sphere.
    Sphere(Sphere),
    /// A cylinder with round ends.
    Capsule(Capsule),
    /// Everything below a plane.
    HalfSpace(HalfSpace),
}

/// Evaluates an expression on the shape of a solid.
macro_rules! on_shape {
    ($solid:expr, $shape:ident => $body:expr) => {
        match $solid {
            $crate::solid::Solid::Cuboid($shape) => $body,
            $crate::solid::Solid::Cylinder($shape) => $body,
            $crate::solid::Solid::Sphere($shape) => $body,
            $crate::solid::Solid::Capsule($shape) => $body,
            $crate::solid::Solid::HalfSpace($shape) => $body,
        }
    };
}
pub(crate) use on_shape;

impl Solid {
    /// Exact signed distance from `p` to the solid's surface, metres, negative inside.
    pub fn distance(&self, p: &Vec3) -> f64 {
        on_shape!(self, shape => shape.distance(p))
    }

    /// Where the line `origin + t * direction` (unit vector) enters and leaves the solid; (+inf, -inf) for a miss.
    pub fn interval(&self, origin: &Vec3, direction: &Vec3) -> (f64, f64) {
        on_shape!(self, shape => shape.interval(origin, direction))
    }

    /// Unit normal, pointing out, of the face that is nearest to a point on or near the surface.
    pub fn normal(&self, p: &Vec3) -> Vec3 {
        let mut faces = self.faces();
        let first = faces.next().map_or((f64::NEG_INFINITY, Vec3::z()), |face| face.eval(p));
        faces.map(|face| face.eval(p)).fold(first, |best, face| if face.0 > best.0 { face } else { best }).1
    }

    /// Corners of the smallest axis-aligned box around the solid; infinite for a half space.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        on_shape!(self, shape => shape.bounds())
    }

    /// Area of the surface, square metres; infinite for a half space.
    pub fn area(&self) -> f64 {
        on_shape!(self, shape => shape.area())
    }

    /// Maps three numbers in 0..1 to a point of the surface, uniformly by area. For a half space it is the projection of the origin.
    pub fn surface_point(&self, u: f64, v: f64, w: f64) -> Vec3 {
        on_shape!(self, shape => shape.surface_point(u, v, w))
    }

    /// The kind of the solid and its parameters, for fingerprints of worlds.
    pub(crate) fn parameters(&self) -> (u64, [f64; 8]) {
        let kind = match self {
            Solid::Cuboid(_) => 0,
            Solid::Cylinder(_) => 1,
            Solid::Sphere(_) => 2,
            Solid::Capsule(_) => 3,
            Solid::HalfSpace(_) => 4,
        };
        (kind, on_shape!(self, shape => shape.parameters()))
    }
}
