//! Intersection tests of shapes with axis-aligned boxes, in voxels.

use super::shape::{Capsule, OrientedBox, Sphere};

/// A shape in finest voxels of a field's frame.
pub(crate) trait Solid {
    /// Corners of a box around the shape with a small margin.
    fn bounds(&self) -> ([f32; 3], [f32; 3]);
    /// Whether the shape touches the closed box from `low` to `high`.
    fn meets(&self, low: [f32; 3], high: [f32; 3]) -> bool;
    /// Rounding error of [`meets`](Self::meets): if the shape misses a box by more than this, it misses all boxes within.
    fn slack(&self) -> f32;
}

/// Margin of bounds in voxels; larger for large coordinates, where single precision is coarse.
fn margin(largest: f32) -> f32 {
    1e-3 + 1e-6 * largest.abs()
}

fn padded(low: [f32; 3], high: [f32; 3]) -> ([f32; 3], [f32; 3]) {
    (low.map(|c| c - margin(c)), high.map(|c| c + margin(c)))
}

/// How far `c` lies outside of the interval.
#[inline(always)]
fn outside(c: f32, low: f32, high: f32) -> f32 {
    (low - c).max(c - high).max(0.0)
}

/// A sphere.
pub(crate) struct SphereSolid {
    centre: [f32; 3],
    radius: f32,
    squared: f32,
}

impl SphereSolid {
    pub fn new(sphere: &Sphere, per_metre: f64) -> Self {
        let radius = (sphere.radius * per_metre) as f32;
        Self { centre: sphere.centre.map(|c| (c * per_metre) as f32), radius, squared: radius * radius }
    }
}

impl Solid for SphereSolid {
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        padded(self.centre.map(|c| c - self.radius), self.centre.map(|c| c + self.radius))
    }

    // Rounding is monotone: a box within another is computed to be no nearer.
    #[inline(always)]
    fn meets(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let d: [f32; 3] = std::array::from_fn(|k| outside(self.centre[k], low[k], high[k]));
        d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= self.squared
    }

    fn slack(&self) -> f32 {
        0.0
    }
}

/// A swept sphere.
pub(crate) struct CapsuleSolid {
    from: [f32; 3],
    along: [f32; 3],
    inverse: [f32; 3],
    radius: f32,
    bounds: ([f32; 3], [f32; 3]),
}

impl CapsuleSolid {
    pub fn new(capsule: &Capsule, per_metre: f64) -> Self {
        let [from, to] = [capsule.from, capsule.to].map(|p| p.map(|c| (c * per_metre) as f32));
        let radius = (capsule.radius * per_metre) as f32;
        let along: [f32; 3] = std::array::from_fn(|k| to[k] - from[k]);
        let bounds = padded(std::array::from_fn(|k| from[k].min(to[k]) - radius), std::array::from_fn(|k| from[k].max(to[k]) + radius));
        Self { from, along, inverse: along.map(|c| 1.0 / c), radius, bounds }
    }

    /// Half the derivative of the squared distance to the box along the segment: it never falls.
    #[inline(always)]
    fn slope(&self, t: f32, low: [f32; 3], high: [f32; 3]) -> f32 {
        (0..3)
            .map(|k| {
                let p = self.from[k] + t * self.along[k];
                self.along[k] * (p - p.clamp(low[k], high[k]))
            })
            .sum()
    }

    /// Where on the segment, 0 to 1, the box is nearest. Between the places where the segment passes the planes of the
    /// box's faces the slope is linear, so its zero follows from its values at those places.
    fn nearest(&self, low: [f32; 3], high: [f32; 3]) -> f32 {
        let (mut before, mut after) = ((0.0, self.slope(0.0, low, high)), (1.0, self.slope(1.0, low, high)));
        if before.1 >= 0.0 {
            return 0.0;
        }
        if after.1 <= 0.0 {
            return 1.0;
        }
        for k in 0..3 {
            for plane in [low[k], high[k]] {
                let t = (plane - self.from[k]) * self.inverse[k];
                if t > before.0 && t < after.0 {
                    let slope = self.slope(t, low, high);
                    *if slope < 0.0 { &mut before } else { &mut after } = (t, slope);
                }
            }
        }
        before.0 + (after.0 - before.0) * (before.1 / (before.1 - after.1))
    }
}

impl Solid for CapsuleSolid {
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        self.bounds
    }

    fn meets(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let (least, most) = self.bounds;
        if (0..3).any(|k| low[k] > most[k] || high[k] < least[k]) {
            return false;
        }
        let t = self.nearest(low, high);
        let squared: f32 = (0..3).map(|k| outside(self.from[k] + t * self.along[k], low[k], high[k]).powi(2)).sum();
        squared <= self.radius * self.radius
    }

    fn slack(&self) -> f32 {
        self.bounds.1.iter().chain(&self.bounds.0).fold(0.0, |most, &c| margin(c).max(most))
    }
}

/// A box in any orientation.
pub(crate) struct BoxSolid {
    centre: [f32; 3],
    /// Unit vectors along the edges.
    axes: [[f32; 3]; 3],
    half: [f32; 3],
    /// Half extents of the bounding box.
    reach: [f32; 3],
}

impl BoxSolid {
    pub fn new(oriented: &OrientedBox, per_metre: f64) -> Self {
        let r = oriented.t_frame_box.rotation.to_rotation_matrix();
        let half = oriented.half.map(|h| (h * per_metre) as f32);
        let axes: [[f32; 3]; 3] = std::array::from_fn(|j| std::array::from_fn(|k| r[(k, j)] as f32));
        let reach = std::array::from_fn(|k| (0..3).map(|j| axes[j][k].abs() * half[j]).sum());
        let t = oriented.t_frame_box.translation.vector;
        Self { centre: std::array::from_fn(|k| (t[k] * per_metre) as f32), axes, half, reach }
    }

    /// Whether `axis` separates this box from the one with half extents `half` at `offset` from its centre. Rounding may report boxes as
    /// touching that miss each other by less than the tolerance, never the other way round.
    #[inline(always)]
    fn is_separated(&self, axis: [f32; 3], offset: [f32; 3], half: [f32; 3]) -> bool {
        const TOLERANCE: f32 = 1.0 + 1e-5;
        let along = |v: [f32; 3]| v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2];
        let own: f32 = (0..3).map(|j| along(self.axes[j]).abs() * self.half[j]).sum();
        let other: f32 = (0..3).map(|k| axis[k].abs() * half[k]).sum();
        along(offset).abs() > (own + other) * TOLERANCE + 1e-5
    }
}

impl Solid for BoxSolid {
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        padded(std::array::from_fn(|k| self.centre[k] - self.reach[k]), std::array::from_fn(|k| self.centre[k] + self.reach[k]))
    }

    /// Separating axes: the faces of both boxes, then the cross products of their edges.
    fn meets(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        let half: [f32; 3] = std::array::from_fn(|k| 0.5 * (high[k] - low[k]));
        let offset: [f32; 3] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]) - self.centre[k]);
        if (0..3).any(|k| offset[k].abs() > half[k] + self.reach[k]) || self.axes.iter().any(|&a| self.is_separated(a, offset, half)) {
            return false;
        }
        // Cross products with the axes of the frame.
        !self.axes.iter().any(|&[x, y, z]| [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]].into_iter().any(|axis| self.is_separated(axis, offset, half)))
    }

    fn slack(&self) -> f32 {
        (0..3).fold(0.0, |most, k| margin(self.centre[k].abs() + self.reach[k]).max(most))
    }
}

/// Boxes that touch both of two shapes.
pub(crate) struct Both<'a, A, B>(pub &'a A, pub &'a B);

impl<A: Solid, B: Solid> Solid for Both<'_, A, B> {
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        let (a, b) = (self.0.bounds(), self.1.bounds());
        (std::array::from_fn(|k| a.0[k].max(b.0[k])), std::array::from_fn(|k| a.1[k].min(b.1[k])))
    }

    fn meets(&self, low: [f32; 3], high: [f32; 3]) -> bool {
        self.0.meets(low, high) && self.1.meets(low, high)
    }

    fn slack(&self) -> f32 {
        self.0.slack().max(self.1.slack())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = [f64; 3]> {
        prop::array::uniform3(-10.0..10.0f64)
    }

    /// Distance from a point to a box, squared.
    fn to_box(p: [f64; 3], low: [f32; 3], high: [f32; 3]) -> f64 {
        (0..3).map(|k| (f64::from(low[k]) - p[k]).max(p[k] - f64::from(high[k])).max(0.0).powi(2)).sum()
    }

    fn cube() -> impl Strategy<Value = ([f32; 3], [f32; 3])> {
        (prop::array::uniform3(-12i32..12), 1i32..6).prop_map(|(c, e)| (c.map(|v| v as f32), c.map(|v| (v + e) as f32)))
    }

    proptest! {
        #[test]
        fn a_capsule_meets_a_cube_within_its_radius_of_the_segment(from in point(), to in point(), radius in 0.0..3.0f64, (low, high) in cube()) {
            let capsule = CapsuleSolid::new(&Capsule { from, to, radius }, 1.0);
            let nearest = (0..=4000)
                .map(|i| f64::from(i) / 4000.0)
                .map(|t| to_box(std::array::from_fn(|k| from[k] + t * (to[k] - from[k])), low, high))
                .fold(f64::INFINITY, f64::min)
                .sqrt();
            prop_assume!((nearest - radius).abs() > 0.01);
            prop_assert_eq!(capsule.meets(low, high), nearest < radius);
        }

        #[test]
        fn a_box_meets_a_cube_when_they_share_a_point(centre in point(), half in prop::array::uniform3(0.3..4.0f64), angles in prop::array::uniform3(-3.0..3.0f64), (low, high) in cube()) {
            let t = Pose::from_parts(Translation3::from(centre), UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]));
            let block = BoxSolid::new(&OrientedBox { t_frame_box: t, half }, 1.0);
            // Alternating projections between two convex sets find a common point, or their distance.
            let mut p = nalgebra::Point3::from(centre);
            let mut gap = 0.0;
            for _ in 0..600 {
                let q = nalgebra::Point3::from(std::array::from_fn::<f64, 3, _>(|k| p[k].clamp(f64::from(low[k]), f64::from(high[k]))));
                let local = t.inverse_transform_point(&q);
                p = t * nalgebra::Point3::from(std::array::from_fn::<f64, 3, _>(|k| local[k].clamp(-half[k], half[k])));
                gap = (p - q).norm();
            }
            prop_assume!(!(1e-9..=0.02).contains(&gap));
            prop_assert_eq!(block.meets(low, high), gap < 1e-9);
        }
    }
}
