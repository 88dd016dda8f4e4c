//! Where a frame lies in that of a map, as people write it.

use crate::precision::{LARGEST, near};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;

/// The pose of a frame in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame(pub Pose);

impl Frame {
    /// Reads `X,Y,Z`, `X,Y,Z,YAW` (degrees) or `x y z qx qy qz qw`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let words = text.split([' ', ',']).filter(|word| !word.is_empty());
        let numbers: Option<Vec<f64>> = words.map(|n| n.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let (x, y, z, rotation) = match numbers.as_deref() {
            Some([x, y, z]) => (x, y, z, UnitQuaternion::identity()),
            Some([x, y, z, yaw]) => (x, y, z, UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw.to_radians())),
            Some([x, y, z, qx, qy, qz, qw]) => {
                let rotation = Quaternion::new(*qw, *qx, *qy, *qz);
                if (rotation.norm() - 1.0).abs() > 1e-2 {
                    return Err(format!("the norm of the quaternion is {:.3}, but must be 1; the order is qx qy qz qw", rotation.norm()));
                }
                (x, y, z, UnitQuaternion::from_quaternion(rotation))
            }
            _ => return Err("must be X,Y,Z in metres, with YAW in degrees if it is turned; or x y z qx qy qz qw".to_owned()),
        };
        near(Pose::from_parts(Translation3::new(*x, *y, *z), rotation), LARGEST).map(Self)
    }
}

/// A pose as `--json` has it: x y z qx qy qz qw.
pub fn numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// The pose that such numbers are; none if they are none.
pub fn pose_of([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Option<Pose> {
    let rotation = Quaternion::new(qw, qx, qy, qz);
    let is_pose = [x, y, z].iter().all(|v| v.is_finite()) && (rotation.norm() - 1.0).abs() < 1e-3;
    is_pose.then(|| Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::geometry::PoseExt;

    #[test]
    fn three_forms_are_read() {
        let turned = Frame::parse("1,-2,3,90").unwrap().0;
        assert!((turned * nalgebra::Point3::new(1.0, 0.0, 0.0) - nalgebra::Point3::new(1.0, -1.0, 3.0)).norm() < 1e-12);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!(Frame::parse(&format!("1 -2 3 0 0 {half} {half}")).unwrap().0.rotation_distance(&turned) < 1e-12);
        assert_eq!(Frame::parse("0,0,0").unwrap().0, Pose::identity());
        for wrong in ["", "1,2", "1,2,x", "1 2 3 0 0 0 2", "1,2,inf", "1e300,0,0", "0,0,-2e8,90"] {
            assert!(Frame::parse(wrong).is_err(), "{wrong}");
        }
    }
}
