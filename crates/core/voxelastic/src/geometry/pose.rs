//! Poses: `t_a_b` maps coordinates in frame b to frame a.

/// A rigid transform in double precision. Name it after its frames: `t_map_lidar` maps lidar to map coordinates.
pub type Pose = nalgebra::Isometry3<f64>;

/// Distances between poses.
pub trait PoseExt {
    /// Euclidean distance between the translations, metres.
    fn translation_distance(&self, other: &Self) -> f64;
    /// Angle of the relative rotation, radians.
    fn rotation_distance(&self, other: &Self) -> f64;
}

impl PoseExt for Pose {
    fn translation_distance(&self, other: &Self) -> f64 {
        (self.translation.vector - other.translation.vector).norm()
    }

    fn rotation_distance(&self, other: &Self) -> f64 {
        self.rotation.angle_to(&other.rotation)
    }
}

/// A rigid transform as a single-precision matrix, for hot loops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// Rotation matrix, row by row.
    pub rotation: [[f32; 3]; 3],
    /// Translation, metres.
    pub translation: [f32; 3],
}

impl From<&Pose> for Rigid {
    fn from(pose: &Pose) -> Self {
        let r = pose.rotation.to_rotation_matrix();
        let m = r.matrix();
        Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)] as f32)),
            translation: std::array::from_fn(|i| pose.translation.vector[i] as f32),
        }
    }
}

impl Rigid {
    /// Rotates a direction into the target frame.
    #[inline(always)]
    pub fn rotate(&self, v: [f32; 3]) -> [f32; 3] {
        let r = &self.rotation;
        std::array::from_fn(|i| r[i][0] * v[0] + r[i][1] * v[1] + r[i][2] * v[2])
    }

    /// Transforms a point, metres, into the target frame.
    #[inline(always)]
    pub fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        let q = self.rotate(p);
        std::array::from_fn(|i| q[i] + self.translation[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Translation3, UnitQuaternion};

    #[test]
    fn single_precision_matrix_moves_points_like_the_pose() {
        let pose = Pose::from_parts(Translation3::new(1.0, -2.0, 3.0), UnitQuaternion::from_euler_angles(0.3, -0.2, 2.0));
        let rigid = Rigid::from(&pose);
        let moved = pose * Point3::new(10.0, 20.0, -5.0);
        let fast = rigid.apply([10.0, 20.0, -5.0]);
        for i in 0..3 {
            assert!((moved[i] as f32 - fast[i]).abs() < 1e-5);
        }
    }

    #[test]
    fn distances_are_metres_and_radians() {
        let a = Pose::identity();
        let b = Pose::from_parts(Translation3::new(3.0, 4.0, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5));
        assert!((a.translation_distance(&b) - 5.0).abs() < 1e-12);
        assert!((a.rotation_distance(&b) - 0.5).abs() < 1e-12);
    }
}
