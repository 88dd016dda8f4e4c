//! What 2-D maps are made for: a robot on the floor.

use clap::Args;
use voxelastic_ground::Body;

/// The robot.
#[derive(Clone, Copy, Debug, Args)]
pub struct BodyArgs {
    /// Height of the robot above the floor, metres: what is higher is no obstacle [default: 1]
    #[arg(long, value_name = "M")]
    pub body_height: Option<f64>,
    /// Largest step that the robot climbs, metres: what is lower is no obstacle [default: 0.1]
    #[arg(long, value_name = "M")]
    pub step: Option<f64>,
    /// Steepest slope that the robot climbs, degrees [default: 25]
    #[arg(long, value_name = "DEG")]
    pub slope: Option<f64>,
}

impl BodyArgs {
    /// The options, and whether they were given.
    pub fn given(&self) -> [(&'static str, bool); 3] {
        [("--body-height", self.body_height.is_some()), ("--step", self.step.is_some()), ("--slope", self.slope.is_some())]
    }

    /// The robot.
    pub fn body(&self) -> Body {
        let usual = Body::default();
        Body {
            height: self.body_height.unwrap_or(usual.height),
            step: self.step.unwrap_or(usual.step),
            slope: self.slope.map_or(usual.slope, f64::to_radians),
        }
    }
}
