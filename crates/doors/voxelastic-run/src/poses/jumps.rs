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
        near(scan.t_map_lidar, LARGEST).map_err(|words| Error::new(format!("the pose of node {} {words}", scan.node), remedy))?;
        let position = scan.t_map_lidar.translation.vector;
        let jump = self.last.map_or(0.0, |last| (position - Vector3::from(last)).norm());
        if jump > LARGEST {
            return Err(Error::new(format!("the pose of node {} is {jump:.0} m from the one before", scan.node), remedy));
        }
        self.last = Some(position.into());
        Ok(())
    }
}
