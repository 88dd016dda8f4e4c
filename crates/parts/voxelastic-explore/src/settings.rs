//! Settings of exploration.

use crate::targets::clusters::FrontierSettings;
use crate::targets::gain::SensorView;
use voxelastic_plan::{PlanError, Point, Robot};

/// Noise of returns that are near the body, metres.
pub(crate) const NOISE: f64 = 0.03;

/// Settings of an [`Explorer`](crate::Explorer).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExploreSettings {
    /// The robot. Its radius should include a margin for what the map does not resolve.
    pub robot: Robot,
    /// The part of the radius that is margin and not body, metres. A robot that stands where it does not fit, as after a correction of the map, may use it up but for 3 cm to get out.
    pub margin: f64,
    /// Speed, metres per second.
    pub speed: f64,
    /// Corners of the box to explore, map frame, metres: the robot stays in it (with its whole ball when it flies, with its centre on wheels), and nothing outside counts.
    /// While no loop closes, what the newest submaps saw may be off by 1 % of the way, and the box is as much larger in them, up to 1 m.
    /// A robot that a correction finds outside of it may come back through what is between.
    pub bounds: [Point; 2],
    /// What the sensor sees.
    pub view: SensorView,
    /// How the frontier is clustered.
    pub frontier: FrontierSettings,
    /// Viewpoints that would show less unknown volume than this are left out, cubic metres.
    pub least_volume: f64,
    /// Distance between neighbouring places of the roadmap, metres.
    pub spacing: f64,
}

impl ExploreSettings {
    /// Settings for a robot that explores a box at 2 m/s; a quarter of its radius is margin.
    pub fn new(robot: Robot, bounds: [Point; 2]) -> Self {
        Self {
            robot,
            margin: 0.25 * robot.radius,
            speed: 2.0,
            bounds,
            view: SensorView::default(),
            frontier: FrontierSettings::default(),
            least_volume: 4.0,
            spacing: if robot.ground.is_some() { 0.45 } else { 0.6 },
        }
    }

    /// Radius of the robot's body: without the margin, metres.
    pub fn body(&self) -> f64 {
        self.robot.radius - self.margin
    }

    /// The same with what noise needs of the margin, metres.
    pub(crate) fn narrowest(&self) -> f64 {
        self.body() + NOISE.min(self.margin)
    }

    /// Checks all numbers.
    ///
    /// # Errors
    /// [`ExploreError::Setting`] for the first that is out of range, [`ExploreError::Robot`].
    pub fn check(&self) -> Result<(), ExploreError> {
        self.robot.check().map_err(ExploreError::Robot)?;
        let positive = [("speed", self.speed), ("spacing", self.spacing), ("range", self.view.range), ("depth", self.view.depth)];
        let bad = positive.into_iter().find(|(_, value)| !(1e-3..=1e5).contains(value));
        if let Some((setting, value)) = bad {
            return Err(ExploreError::Setting { setting, value, must: "must be 0.001 to 100000" });
        }
        if !(0.0..=1e9).contains(&self.least_volume) {
            return Err(ExploreError::Setting { setting: "least_volume", value: self.least_volume, must: "must be 0 to 1e9" });
        }
        if !(0.0..self.robot.radius).contains(&self.margin) {
            return Err(ExploreError::Setting { setting: "margin", value: self.margin, must: "must be at least 0 and less than the robot's radius" });
        }
        let [low, high] = self.bounds;
        match (0..3).find(|&k| (high[k] - low[k]).is_nan() || high[k] <= low[k]) {
            Some(axis) => {
                Err(ExploreError::Setting { setting: "bounds", value: high[axis] - low[axis], must: "must have a positive extent along every axis" })
            }
            None => Ok(()),
        }
    }
}

/// Why a robot cannot explore.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExploreError {
    /// A setting is out of range.
    #[error("{setting} = {value}: {must}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        must: &'static str,
    },
    /// The robot is impossible.
    #[error(transparent)]
    Robot(PlanError),
    /// The map has no occupancy.
    #[error("the map has no occupancy, so nothing says what is free and what is unknown")]
    NoOccupancy,
}
