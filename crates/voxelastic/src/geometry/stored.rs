//! Poses in serialised states, every bit kept: `#[serde(with = "crate::geometry::stored")]`.
//!
//! nalgebra can serialise itself, but that is a feature of all that depends on it, which are most of the crates of a build.

use super::Pose;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Writes x y z, and x y z w of the rotation.
pub(crate) fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
    let (position, rotation): ([f64; 3], [f64; 4]) = (pose.translation.vector.into(), pose.rotation.coords.into());
    (position, rotation).serialize(serializer)
}

/// Reads what [`serialize`] wrote.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
    let (position, [x, y, z, w]) = <([f64; 3], [f64; 4])>::deserialize(deserializer)?;
    // Normalising again would change bits.
    Ok(Pose::from_parts(Translation3::from(position), UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))))
}
