//! The robot: a ball around its centre, in the air or on wheels.

use crate::error::PlanError;
use voxelastic::query::UnknownAs;

/// What moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Robot {
    /// Radius of the ball around the robot's centre that must stay free, metres; 0 for a point.
    pub radius: f64,
    /// What unknown space counts as.
    pub unknown: UnknownAs,
    /// How it keeps to the ground; none for a robot that flies.
    pub ground: Option<Wheels>,
}

/// A robot that keeps its centre at one height above the floor that the map shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wheels {
    /// Height of the centre above the floor, metres; none to take that of the start, or as little as the radius allows.
    pub height: Option<f64>,
    /// Largest step of the floor, up or down, within [`STRIDE`](crate::ground::STRIDE) metres of the way; none for 0.2 m.
    pub step: Option<f64>,
}

impl Robot {
    /// A flying robot that keeps out of unknown space.
    pub fn flying(radius: f64) -> Self {
        Self { radius, unknown: UnknownAs::Blocked, ground: None }
    }

    /// A wheeled robot that keeps out of unknown space, with its centre as high above the floor as the start is.
    pub fn wheeled(radius: f64) -> Self {
        Self { ground: Some(Wheels::default()), ..Self::flying(radius) }
    }

    /// # Errors
    /// [`PlanError::Setting`] for numbers that make no sense.
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
