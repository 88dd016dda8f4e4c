//! Convex solids with closed forms for everything that is asked of them: signed distance, ray interval, normal, bounds.
//!
//! A world is a union of these ([`crate::World`]). Openings (doors, windows, rooms) are made by leaving space between
//! solids, never by subtraction, because the distance to a union is exact outside where that to a difference is not.

mod capsule;
mod cuboid;
mod cylinder;
mod faces;
mod half_space;
mod sphere;

pub use capsule::Capsule;
pub use cuboid::Cuboid;
pub use cylinder::Cylinder;
pub use half_space::HalfSpace;
pub use sphere::Sphere;

pub(crate) use faces::Face;

/// A point or direction in the world frame, metres.
pub type Vec3 = nalgebra::Vector3<f64>;

/// Entry and exit of a ray that misses.
pub(crate) const MISS: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

/// A convex solid in the world frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solid {
    /// A box, turned about the vertical.
    Cuboid(Cuboid),
    /// A finite cylinder about any axis.
    Cylinder(Cylinder),
    /// A ball.
    Sphere(Sphere),
    /// A cylinder with round ends.
    Capsule(Capsule),
    /// Everything below a plane.
    HalfSpace(HalfSpace),
}

/// Runs the same expression on whichever shape a solid is.
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

    /// Where the line `origin + t * direction` (unit vector) enters and leaves the solid; enters at +inf and leaves at
    /// -inf when it misses.
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

    /// The point of the surface that the three numbers in 0..1 choose, uniformly by area. A half space has no such point
    /// and gives the foot of the origin.
    pub fn surface_point(&self, u: f64, v: f64, w: f64) -> Vec3 {
        on_shape!(self, shape => shape.surface_point(u, v, w))
    }

    /// The kind of the solid and the numbers that describe it, to tell worlds apart.
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

/// One over `d`, large but finite where `d` is zero, so that multiplying with it never gives a NaN.
#[inline(always)]
pub(crate) fn reciprocal(d: f64) -> f64 {
    1.0 / if d.abs() < 1e-12 { 1e-12 } else { d }
}

/// Smaller of two numbers that are not NaN; unlike `f64::min` a single instruction.
#[inline(always)]
pub(crate) fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// Larger of two numbers that are not NaN.
#[inline(always)]
pub(crate) fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// Two unit vectors that complete the unit vector `axis` to an orthonormal basis.
pub(crate) fn basis(axis: &Vec3) -> (Vec3, Vec3) {
    let helper = if axis.x.abs() < 0.6 { Vec3::x() } else { Vec3::y() };
    let u = axis.cross(&helper).normalize();
    (u, axis.cross(&u))
}

#[cfg(test)]
mod tests;
