//! Cameras and projections.

use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;
use voxelastic::geometry::Aabb;

/// Kind and extent of a projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Parallel rays: lengths can be measured in the picture. At least this much is visible, metres.
    Orthographic {
        /// Smallest visible width, metres.
        width: f64,
        /// Smallest visible height, metres.
        height: f64,
    },
    /// Rays through one point.
    Perspective {
        /// Vertical opening angle, radians.
        fov_y: f64,
        /// Distance of the near plane, metres.
        near: f64,
    },
}

/// A camera. View frame V: x to the right of the picture, y down, z into the scene.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Maps map to view coordinates.
    pub t_view_map: Pose,
    /// Kind and extent of the view.
    pub projection: Projection,
}

/// Margin around a fitted scene, as a factor.
const MARGIN: f64 = 1.06;

impl Camera {
    /// Orthographic view from above that fits the box, north (map y) up.
    pub fn top(bounds: &Aabb) -> Self {
        Self::orbit(bounds, 0.0, 90.0)
    }

    /// Orthographic view that fits the box. `yaw_deg` rotates the viewer counter-clockwise about the vertical (0 looks along map y, from the
    /// south); `pitch_deg` is the elevation of the viewer above the horizon (90 is from above).
    pub fn orbit(bounds: &Aabb, yaw_deg: f64, pitch_deg: f64) -> Self {
        let (centre, corners) = centre_and_corners(bounds);
        let rotation = view_rotation(yaw_deg, pitch_deg);
        let (mut half_w, mut half_h, mut depth) = (1e-3f64, 1e-3f64, 1e-3f64);
        for c in corners {
            let v = rotation * (c - centre);
            (half_w, half_h, depth) = (half_w.max(v.x.abs()), half_h.max(v.y.abs()), depth.max(v.z.abs()));
        }
        let t_view_map = placed(rotation, centre, 2.0 * depth);
        Self { t_view_map, projection: Projection::Orthographic { width: 2.0 * half_w * MARGIN, height: 2.0 * half_h * MARGIN } }
    }

    /// Perspective view of the whole box from the direction of [`Camera::orbit`], with a vertical opening angle of `fov_deg`, for a picture
    /// of the given width over height.
    pub fn perspective_orbit(bounds: &Aabb, yaw_deg: f64, pitch_deg: f64, fov_deg: f64, aspect: f64) -> Self {
        let (centre, corners) = centre_and_corners(bounds);
        let rotation = view_rotation(yaw_deg, pitch_deg);
        let fov_y = fov_deg.clamp(1.0, 150.0).to_radians();
        let tan_y = (fov_y / 2.0).tan() / MARGIN;
        let tan_x = tan_y * aspect.max(1e-3);
        // Near corners reach further out than far ones: shift the view until the margins agree.
        let (mut shift, mut distance) = (Vector3::zeros(), 0.1f64);
        for _ in 0..8 {
            let seen = corners.map(|c| rotation * (c - centre) + shift);
            distance = seen.iter().map(|v| (v.x.abs() / tan_x).max(v.y.abs() / tan_y) - v.z).fold(0.1, f64::max);
            for k in 0..2 {
                let slopes = seen.map(|v| v[k] / (v.z + distance));
                let (lo, hi) = slopes.iter().fold((f64::MAX, f64::MIN), |(lo, hi), s| (lo.min(*s), hi.max(*s)));
                shift[k] -= 0.5 * (lo + hi) * distance;
            }
        }
        let seen = corners.map(|c| rotation * (c - centre) + shift);
        distance = seen.iter().map(|v| (v.x.abs() / tan_x).max(v.y.abs() / tan_y) - v.z).fold(distance * 0.5, f64::max);
        let centre = centre - rotation.inverse() * shift;
        Self { t_view_map: placed(rotation, centre, distance), projection: Projection::Perspective { fov_y, near: (distance * 1e-3).max(0.02) } }
    }

    /// Perspective view from `eye` to `target` (map frame, metres) with a vertical opening angle of `fov_deg`; map z is up in the picture.
    pub fn look_at(eye: [f64; 3], target: [f64; 3], fov_deg: f64) -> Self {
        let (eye, target) = (Point3::from(eye), Point3::from(target));
        let forward = (target - eye).try_normalize(1e-9).unwrap_or_else(Vector3::y);
        let right = forward.cross(&Vector3::z()).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let rotation = rows(right, forward.cross(&right), forward);
        let projection = Projection::Perspective { fov_y: fov_deg.clamp(1.0, 150.0).to_radians(), near: 0.05 };
        Self { t_view_map: placed(rotation, eye, 0.0), projection }
    }

    /// The lens of a picture of `width` x `height` pixels (or samples).
    pub(super) fn lens(&self, width: u32, height: u32) -> Lens {
        let (w, h) = (f64::from(width), f64::from(height));
        let (cx, cy) = ((w / 2.0) as f32, (h / 2.0) as f32);
        match self.projection {
            Projection::Orthographic { width: vw, height: vh } => {
                let focal = (w / vw.max(1e-6)).min(h / vh.max(1e-6)) as f32;
                Lens { focal, cx, cy, near: None }
            }
            Projection::Perspective { fov_y, near } => {
                Lens { focal: (h / 2.0 / (fov_y / 2.0).tan()) as f32, cx, cy, near: Some(near.max(1e-4) as f32) }
            }
        }
    }
}

/// A projection at a resolution: view coordinates to pixels and back. `q` is linear across the picture and larger when nearer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lens {
    /// Pixels per metre (orthographic) or focal length in pixels (perspective).
    pub focal: f32,
    pub cx: f32,
    pub cy: f32,
    /// Near plane; absent for an orthographic view.
    pub near: Option<f32>,
}

impl Lens {
    /// Picture position and `q` of a view point; a perspective point must lie beyond the near plane.
    #[inline(always)]
    pub fn project(&self, v: [f32; 3]) -> [f32; 3] {
        match self.near {
            None => [self.cx + self.focal * v[0], self.cy + self.focal * v[1], -v[2]],
            Some(_) => {
                let q = 1.0 / v[2];
                [self.cx + self.focal * v[0] * q, self.cy + self.focal * v[1] * q, q]
            }
        }
    }

    /// The view point at a picture position with a given `q`.
    #[inline(always)]
    pub fn unproject(&self, x: f32, y: f32, q: f32) -> [f32; 3] {
        let z = match self.near {
            None => return [(x - self.cx) / self.focal, (y - self.cy) / self.focal, -q],
            Some(_) => 1.0 / q,
        };
        [(x - self.cx) / self.focal * z, (y - self.cy) / self.focal * z, z]
    }

    /// Pixels per metre at a view depth.
    #[inline(always)]
    pub fn pixels_per_metre(&self, z: f32) -> f32 {
        if self.near.is_none() { self.focal } else { self.focal / z.max(1e-6) }
    }

    /// Unit vector from a view point to the viewer.
    #[inline(always)]
    pub fn viewer_direction(&self, v: [f32; 3]) -> [f32; 3] {
        if self.near.is_none() { [0.0, 0.0, -1.0] } else { crate::vec3::unit([-v[0], -v[1], -v[2]]) }
    }
}

fn centre_and_corners(bounds: &Aabb) -> (Point3<f64>, [Point3<f64>; 8]) {
    let b = if bounds.is_empty() { Aabb { min: [-1.0; 3], max: [1.0; 3] } } else { *bounds };
    let at = |i: usize, k: usize| f64::from(if i >> k & 1 == 0 { b.min[k] } else { b.max[k] });
    let corners: [Point3<f64>; 8] = std::array::from_fn(|i| Point3::new(at(i, 0), at(i, 1), at(i, 2)));
    (nalgebra::center(&corners[0], &corners[7]), corners)
}

fn view_rotation(yaw_deg: f64, pitch_deg: f64) -> UnitQuaternion<f64> {
    let (yaw, pitch) = (yaw_deg.to_radians(), pitch_deg.to_radians());
    let right = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
    let forward = Vector3::new(-yaw.sin() * pitch.cos(), yaw.cos() * pitch.cos(), -pitch.sin());
    rows(right, forward.cross(&right), forward)
}

/// The rotation whose rows are the view axes in map coordinates.
fn rows(right: Vector3<f64>, down: Vector3<f64>, forward: Vector3<f64>) -> UnitQuaternion<f64> {
    let m = Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m))
}

/// The view pose with `point` of the map straight ahead at `distance`.
fn placed(rotation: UnitQuaternion<f64>, point: Point3<f64>, distance: f64) -> Pose {
    let t = Vector3::new(0.0, 0.0, distance) - (rotation * point).coords;
    Pose::from_parts(Translation3::from(t), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn top_view_has_east_right_and_north_up() {
        let camera = Camera::top(&Aabb { min: [0.0; 3], max: [10.0, 10.0, 3.0] });
        let lens = camera.lens(100, 100);
        let at = |x: f64, y: f64, z: f64| {
            let v = camera.t_view_map * Point3::new(x, y, z);
            lens.project([v.x as f32, v.y as f32, v.z as f32])
        };
        assert!(at(9.0, 5.0, 0.0)[0] > at(1.0, 5.0, 0.0)[0]);
        assert!(at(5.0, 9.0, 0.0)[1] < at(5.0, 1.0, 0.0)[1]);
        assert!(at(5.0, 5.0, 3.0)[2] > at(5.0, 5.0, 0.0)[2], "higher is nearer");
    }

    #[test]
    fn fitted_boxes_are_inside_the_picture_and_unproject_inverts_project() {
        let b = Aabb { min: [-3.0, 10.0, 0.0], max: [40.0, 70.0, 12.0] };
        for camera in [Camera::orbit(&b, 33.0, 40.0), Camera::perspective_orbit(&b, 210.0, 25.0, 50.0, 1.5)] {
            let lens = camera.lens(300, 200);
            for c in centre_and_corners(&b).1 {
                let v = camera.t_view_map * c;
                let v = [v.x as f32, v.y as f32, v.z as f32];
                let p = lens.project(v);
                assert!((0.0..300.0).contains(&p[0]) && (0.0..200.0).contains(&p[1]), "{p:?}");
                let back = lens.unproject(p[0], p[1], p[2]);
                assert!((0..3).all(|k| (back[k] - v[k]).abs() < 1e-2), "{back:?} {v:?}");
            }
        }
    }
}
