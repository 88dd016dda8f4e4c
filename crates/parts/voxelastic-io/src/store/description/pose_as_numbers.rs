//! Poses as `[x, y, z, qx, qy, qz, qw]`, the order of TUM trajectories, every bit kept.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use voxelastic::Pose;

/// How far a quaternion's norm may be from 1.
const TOLERANCE: f64 = 1e-3;

pub(crate) fn check(pose: &Pose) -> Result<(), String> {
    let norm = pose.rotation.norm();
    if !numbers(pose).iter().all(|n| n.is_finite()) {
        Err("is not finite".to_owned())
    } else if (norm - 1.0).abs() > TOLERANCE {
        Err(format!("has a quaternion of norm {norm} instead of 1"))
    } else {
        Ok(())
    }
}

fn numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

pub(crate) fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
    numbers(pose).serialize(serializer)
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
    let [x, y, z, qx, qy, qz, qw] = <[f64; 7]>::deserialize(deserializer)?;
    // Normalising again would change bits.
    let pose = Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)));
    check(&pose).map_err(|e| de::Error::custom(format!("a pose {e}")))?;
    Ok(pose)
}
