//! Scans whose poses jump farther than anything moves on Earth.

use crate::Error;
use crate::precision::{LARGEST, near};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use voxelastic::event::Event;
use voxelastic::geometry::stored::StoredVector;

/// Compares positions of scans with those of the scans before.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Jumps {
    last: Option<StoredVector>,
}

impl Jumps {
    /// Refuses a scan that is too far from zero, or from the last one that was not refused: a mistake in the poses, of units, or a number that is garbage.
    pub fn check(&mut self, event: &Event) -> Result<(), Error> {
        let Event::Scan(scan) = event else { return Ok(()) };
        let remedy = "correct the pose; the unit is metres";
        let position = scan.t_map_lidar.translation.vector;
        let jump = self.last.map_or(0.0, |last| (position - Vector3::from(last)).norm());
        if jump > LARGEST {
            return Err(Error::new(format!("the pose of node {} is {jump:.0} m from the one before", scan.node), remedy));
        }
        // What is not finite has a message of its own.
        let words = near(scan.t_map_lidar, LARGEST).err().filter(|_| position.iter().all(|c| c.is_finite()));
        if let Some(words) = words {
            return Err(Error::new(format!("the pose of node {} {words}", scan.node), remedy));
        }
        self.last = Some(position.into());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;
    use voxelastic::event::Scan;

    #[test]
    fn poses_beyond_reason_are_refused_also_the_first() {
        let mut jumps = Jumps::default();
        let mut check = |x: f64| {
            let scan = Scan { node: 1, time: 0.0, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud: voxelastic::Cloud::default() };
            jumps.check(&Event::Scan(scan)).map_err(|error| error.to_string())
        };
        assert!(check(1e12).unwrap_err().contains("from the origin") && check(1e300).is_err());
        assert!(check(5e6).is_ok() && check(-4e8).unwrap_err().contains("from the one before") && check(5.1e6).is_ok());
    }
}
