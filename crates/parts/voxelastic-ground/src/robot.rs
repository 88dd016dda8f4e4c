//! What a robot on the ground needs and can do.

use crate::GroundError;

/// What a robot's body needs above the ground, and what its wheels or legs climb.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Height of the robot above the ground, metres: what is higher is no obstacle.
    pub height: f64,
    /// Largest step that it climbs, metres: what is lower is no obstacle.
    pub step: f64,
    /// Steepest slope that it climbs, radians.
    pub slope: f64,
}

impl Default for Body {
    fn default() -> Self {
        Self { height: 1.0, step: 0.1, slope: 25f64.to_radians() }
    }
}

impl Body {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`GroundError::Robot`] for the first that is out of range.
    pub fn check(&self) -> Result<(), GroundError> {
        let bad = |what, value, must| Err(GroundError::Robot { what, value, must });
        if !(0.05..=100.0).contains(&self.height) {
            return bad("height", self.height, "0.05 to 100 m");
        }
        if !(0.0..=2.0).contains(&self.step) || self.step >= self.height {
            return bad("largest step", self.step, "0 to 2 m, and less than its height");
        }
        if !(0.0..=80f64.to_radians()).contains(&self.slope) {
            return bad("steepest slope", self.slope.to_degrees(), "0 to 80 degrees");
        }
        Ok(())
    }
}
