//! Vectors and arithmetic that the shapes share.

/// A point or direction in the world frame, metres.
pub type Vec3 = nalgebra::Vector3<f64>;

/// Entry and exit of a ray that misses.
pub(crate) const MISS: (f64, f64) = (f64::INFINITY, f64::NEG_INFINITY);

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
