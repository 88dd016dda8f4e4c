//! Poses that were written down otherwise than they are read, and what makes them right again.

use super::Pose;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::fmt;
use std::str::FromStr;

/// Another reading of a trajectory: what to change of the poses in a file, or of their order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseChange {
    /// The poses are those of the map in the sensor's frame.
    pub inverse: bool,
    /// The quaternions have w first, and were read with w last.
    pub w_first: bool,
    /// The translations are to be multiplied by this: 0.001 where they are in millimetres.
    pub scale: f64,
    /// Scan `k` has the pose of row `k + rows`.
    pub rows: i64,
    /// A scan at time `t` has the pose of time `t + seconds`.
    pub seconds: f64,
}

impl Default for PoseChange {
    fn default() -> Self {
        Self { inverse: false, w_first: false, scale: 1.0, rows: 0, seconds: 0.0 }
    }
}

impl PoseChange {
    /// Whether it changes nothing.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// One pose, read otherwise. Rows and seconds are about which one it is.
    pub fn apply(&self, pose: &Pose) -> Pose {
        let mut rotation = pose.rotation;
        if self.w_first {
            // What was read as x, y, z, w was w, x, y, z.
            let read = rotation.coords;
            rotation = UnitQuaternion::from_quaternion(Quaternion::new(read.x, read.y, read.z, read.w));
        }
        let pose = Pose::from_parts(Translation3::from(pose.translation.vector * self.scale), rotation);
        if self.inverse { pose.inverse() } else { pose }
    }
}

impl fmt::Display for PoseChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        self.inverse.then(|| parts.push("inverse".to_owned()));
        self.w_first.then(|| parts.push("w-first".to_owned()));
        (self.scale != 1.0).then(|| parts.push(format!("scale={}", self.scale)));
        (self.rows != 0).then(|| parts.push(format!("rows={}", self.rows)));
        (self.seconds != 0.0).then(|| parts.push(format!("seconds={}", self.seconds)));
        f.write_str(&parts.join(","))
    }
}

impl FromStr for PoseChange {
    type Err = String;

    /// Parts with commas between them: `inverse`, `w-first`, `scale=0.001`, `rows=1`, `seconds=0.35`.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut change = Self::default();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            let wrong = || format!("{part:?} is none of: inverse, w-first, scale=FACTOR, rows=N, seconds=S");
            let number = || value.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(wrong);
            match name.trim() {
                "inverse" if value.is_empty() => change.inverse = true,
                "w-first" if value.is_empty() => change.w_first = true,
                "scale" => change.scale = Some(number()?).filter(|v| *v > 0.0).ok_or_else(wrong)?,
                "rows" => change.rows = value.trim().parse().map_err(|_| wrong())?,
                "seconds" => change.seconds = number()?,
                _ => return Err(wrong()),
            }
        }
        Ok(change)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_read_as_it_is_written() {
        let change = PoseChange { inverse: true, w_first: true, scale: 0.001, rows: -2, seconds: 0.35 };
        assert_eq!(change.to_string(), "inverse,w-first,scale=0.001,rows=-2,seconds=0.35");
        assert_eq!(change.to_string().parse(), Ok(change));
        assert_eq!("".parse(), Ok(PoseChange::default()));
        for wrong in ["invers", "scale", "scale=-1", "scale=nan", "rows=0.5", "inverse=1"] {
            assert!(wrong.parse::<PoseChange>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_was_written_otherwise_is_right_again() {
        let right = Pose::from_parts(Translation3::new(1.0, -2.0, 3.0), UnitQuaternion::from_euler_angles(0.3, -0.2, 2.0));
        let q = right.rotation.coords;
        let w_first = UnitQuaternion::from_quaternion(Quaternion::new(q.z, q.w, q.x, q.y));
        let written = Pose::from_parts(Translation3::from(right.translation.vector * 1000.0), w_first);
        let change = PoseChange { w_first: true, scale: 0.001, ..PoseChange::default() };
        assert!((change.apply(&written).to_homogeneous() - right.to_homogeneous()).amax() < 1e-12);
        let change = PoseChange { inverse: true, ..PoseChange::default() };
        assert!((change.apply(&right.inverse()).to_homogeneous() - right.to_homogeneous()).amax() < 1e-12);
    }
}
