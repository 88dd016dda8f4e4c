//! Poses and vectors in serialised states, every bit kept: `#[serde(with = "voxelastic::geometry::stored")]`.
//!
//! nalgebra can serialise itself, but that is a feature of all that depends on it, which are most of the crates of a build.

use super::Pose;
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Writes x y z, and x y z w of the rotation.
///
/// # Errors
/// Those of the serialiser.
pub fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
    let (position, rotation): ([f64; 3], [f64; 4]) = (pose.translation.vector.into(), pose.rotation.coords.into());
    (position, rotation).serialize(serializer)
}

/// Reads what [`serialize`] wrote.
///
/// # Errors
/// Those of the deserialiser.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
    let (position, [x, y, z, w]) = <([f64; 3], [f64; 4])>::deserialize(deserializer)?;
    // Normalising again would change bits.
    Ok(Pose::from_parts(Translation3::from(position), UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))))
}

/// A pose that serialises itself, for lists, pairs and options of poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredPose(#[serde(with = "crate::geometry::stored")] pub Pose);

/// A vector that serialises itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredVector([f64; 3]);

impl From<Vector3<f64>> for StoredVector {
    fn from(vector: Vector3<f64>) -> Self {
        Self(vector.into())
    }
}

impl From<StoredVector> for Vector3<f64> {
    fn from(stored: StoredVector) -> Self {
        stored.0.into()
    }
}
