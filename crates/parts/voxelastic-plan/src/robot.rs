//! The robot: a ball around its centre that flies or rolls.

use crate::error::PlanError;
use voxelastic::query::UnknownAs;

/// The robot to plan for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Robot {
    /// Radius of the ball around the robot's centre that must stay free, metres; 0 for a point.
    pub radius: f64,
    /// Whether unknown space counts as free or as blocked.
    pub unknown: UnknownAs,
    /// How it follows the ground; none for a robot that flies.
    pub ground: Option<Wheels>,
}

/// How a wheeled robot follows the floor of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wheels {
    /// Height of the centre above the floor, metres; none to use the height of the start, at least what the radius needs.
    pub height: Option<f64>,
    /// Largest step of the floor, up or down, within [`STRIDE`](crate::STRIDE) metres; none for 0.2 m.
    pub step: Option<f64>,
}

impl Robot {
    /// A flying robot that avoids unknown space.
    pub fn flying(radius: f64) -> Self {
        Self { radius, unknown: UnknownAs::Blocked, ground: None }
    }

    /// A wheeled robot that avoids unknown space, with its centre as high above the floor as the start is.
    pub fn wheeled(radius: f64) -> Self {
        Self { ground: Some(Wheels::default()), ..Self::flying(radius) }
    }

    /// Checks that all lengths are 0 to 100 m.
    ///
    /// # Errors
    /// [`PlanError::Setting`] for the first one that is not.
    pub fn check(&self) -> Result<(), PlanError> {
        let length = |what, value: Option<f64>| match value.filter(|v| !(0.0..=100.0).contains(v)) {
            Some(value) => Err(PlanError::Setting { what, value, must: "must be 0 to 100 m" }),
            None => Ok(()),
        };
        length("the robot's radius", Some(self.radius))?;
        let wheels = self.ground.unwrap_or_default();
        length("the robot's height above the floor", wheels.height)?;
        length("the largest step", wheels.step)
    }
}
