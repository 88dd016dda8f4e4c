//! Scans whose poses jump farther than anything moves on Earth.

use crate::Error;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use voxelastic::event::Event;
use voxelastic::geometry::stored::StoredVector;

/// A jump of this length, metres, is a mistake in the poses: one of units, or a number that is garbage. Longer maps than the Earth is wide do not exist.
const LARGEST: f64 = 1e8;

/// Compares positions of scans with those of the scans before.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Jumps {
    last: Option<StoredVector>,
}

impl Jumps {
    /// Refuses a scan that is too far from the last one that was not refused.
    pub fn check(&mut self, event: &Event) -> Result<(), Error> {
        let Event::Scan(scan) = event else { return Ok(()) };
        let position = scan.t_map_lidar.translation.vector;
        let jump = self.last.map_or(0.0, |last| (position - Vector3::from(last)).norm());
        if jump > LARGEST {
            let remedy = "correct the pose; the unit is metres";
            return Err(Error::new(format!("the pose of node {} is {jump:.0} m from the one before", scan.node), remedy));
        }
        self.last = Some(position.into());
        Ok(())
    }
}
