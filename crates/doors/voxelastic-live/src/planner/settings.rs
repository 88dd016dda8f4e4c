//! What a robot that explores is, and where it is to explore.

use crate::near_scans::Beams;
use voxelastic::query::UnknownAs;
use voxelastic_explore::{ExploreSettings, SensorView};
use voxelastic_plan::{Point, Robot, Wheels};

/// By itself the box reaches so far from where exploring begins: to the sides, below and above, metres.
const REACH: [f64; 3] = [50.0, 0.7, 1.0];

/// Settings of a [`LivePlanner`](super::LivePlanner).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannerSettings {
    /// Radius of the body, metres.
    pub radius: f64,
    /// What paths keep clear of beside the body, metres.
    pub margin: f64,
    /// Height of the lidar above the floor for a robot on wheels, metres; none for one that flies.
    pub height: Option<f64>,
    /// Metres per second.
    pub speed: f64,
    /// Corners of the box to explore, map frame, metres; none for 50 m to the sides of where exploring begins, 0.7 m below and 1 m above.
    pub bounds: Option<[Point; 2]>,
    /// Time from the first scan on after which the robot must be at home, seconds; none for any.
    pub time: Option<f64>,
    /// Range up to which returns are mapped, metres.
    pub max_range: f64,
    /// Viewpoints that would show less unknown volume than this are left out, cubic metres.
    pub least_volume: f64,
}

impl PlannerSettings {
    /// Settings of the explorer for a robot that begins at `start` with these beams, in a map with voxels of `voxel` metres.
    pub(super) fn explorer(&self, start: Point, beams: Option<Beams>, voxel: f64) -> ExploreSettings {
        let [side, below, above] = REACH;
        let around = [[start[0] - side, start[1] - side, start[2] - below], [start[0] + side, start[1] + side, start[2] + above]];
        let ground = self.height.map(|height| Wheels { height: Some(height), step: None });
        let robot = Robot { radius: self.radius + self.margin, unknown: UnknownAs::Blocked, ground };
        let view = SensorView::of(beams.into_iter().flat_map(|beams| beams.elevations), self.max_range);
        let view = beams.map_or(view, |beams| view.resolving(beams.spacing, voxel));
        ExploreSettings {
            margin: self.margin,
            speed: self.speed,
            view,
            least_volume: self.least_volume,
            ..ExploreSettings::new(robot, self.bounds.unwrap_or(around))
        }
    }

    /// The same before anything was seen.
    pub(super) fn before(&self) -> ExploreSettings {
        self.explorer([0.0; 3], None, 1.0)
    }
}
