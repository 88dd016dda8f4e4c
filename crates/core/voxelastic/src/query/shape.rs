//! Shapes for collision checks, in any frame; lengths in metres.

use crate::geometry::Pose;
use nalgebra::Point3;

/// A sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre.
    pub centre: [f64; 3],
    /// Radius, not negative.
    pub radius: f64,
}

/// All points within a distance of a line segment: a sphere swept from one end to the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// One end of the segment.
    pub from: [f64; 3],
    /// The other end.
    pub to: [f64; 3],
    /// Radius, not negative.
    pub radius: f64,
}

/// A box in any orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedBox {
    /// The box's frame (origin at its centre, axes along its edges) in the frame of the query.
    pub t_frame_box: Pose,
    /// Half of each edge length, not negative.
    pub half: [f64; 3],
}

/// A shape. One that is not finite or has a negative size is never free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A sphere.
    Sphere(Sphere),
    /// A swept sphere.
    Capsule(Capsule),
    /// A box.
    Box(OrientedBox),
}

impl From<Sphere> for Shape {
    fn from(sphere: Sphere) -> Self {
        Self::Sphere(sphere)
    }
}

impl From<Capsule> for Shape {
    fn from(capsule: Capsule) -> Self {
        Self::Capsule(capsule)
    }
}

impl From<OrientedBox> for Shape {
    fn from(oriented: OrientedBox) -> Self {
        Self::Box(oriented)
    }
}

/// `p` transformed by `t`.
pub(super) fn moved(t: &Pose, p: [f64; 3]) -> [f64; 3] {
    (t * Point3::from(p)).coords.into()
}

impl Shape {
    /// The shape in the frame that `t_to_from` maps to.
    #[must_use]
    pub fn moved(&self, t_to_from: &Pose) -> Self {
        match self {
            Self::Sphere(s) => Self::Sphere(Sphere { centre: moved(t_to_from, s.centre), ..*s }),
            Self::Capsule(c) => Self::Capsule(Capsule { from: moved(t_to_from, c.from), to: moved(t_to_from, c.to), ..*c }),
            Self::Box(b) => Self::Box(OrientedBox { t_frame_box: t_to_from * b.t_frame_box, ..*b }),
        }
    }

    /// Whether every number is finite and no size negative.
    pub fn is_valid(&self) -> bool {
        let finite = |p: &[f64]| p.iter().all(|c| c.is_finite());
        let size = |r: f64| r.is_finite() && r >= 0.0;
        match self {
            Self::Sphere(s) => finite(&s.centre) && size(s.radius),
            Self::Capsule(c) => finite(&c.from) && finite(&c.to) && size(c.radius),
            Self::Box(b) => {
                finite(b.t_frame_box.translation.vector.as_slice())
                    && finite(b.t_frame_box.rotation.coords.as_slice())
                    && b.half.iter().all(|h| size(*h))
            }
        }
    }

    /// Smallest and largest corner of the shape's axis-aligned bounding box.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let around =
            |centre: [f64; 3], reach: [f64; 3]| (std::array::from_fn(|k| centre[k] - reach[k]), std::array::from_fn(|k| centre[k] + reach[k]));
        match self {
            Self::Sphere(s) => around(s.centre, [s.radius; 3]),
            Self::Capsule(c) => {
                (std::array::from_fn(|k| c.from[k].min(c.to[k]) - c.radius), std::array::from_fn(|k| c.from[k].max(c.to[k]) + c.radius))
            }
            Self::Box(b) => {
                let r = b.t_frame_box.rotation.to_rotation_matrix();
                around(b.t_frame_box.translation.vector.into(), std::array::from_fn(|k| (0..3).map(|j| r[(k, j)].abs() * b.half[j]).sum()))
            }
        }
    }
}
