//! Arguments for a robot that explores while the map grows.

use crate::commands::space::explore::{MARGIN, radius, seconds, speed, within};
use crate::commands::space::slice::{Corners, corners};
use crate::failure::Failure;
use clap::Args;
use voxelastic::Settings;
use voxelastic::settings::{FieldKind, RobotRadius};
use voxelastic_explore::SensorView;
use voxelastic_io::Origin;
use voxelastic_live::planner::PlannerSettings;

/// Viewpoints that would show less are left out, cubic metres.
const LEAST_VOLUME: f64 = 4.0;

/// Arguments for a robot that explores.
#[derive(Debug, Args)]
#[command(next_help_heading = "Exploring")]
pub struct ExploringArgs {
    /// Plan where to go next, to see what is not known yet: frontier, path and goal are published over ROS 2 and to Foxglove while the map grows, and services start it, hold it and send it
    /// home. Nothing is steered: the robot's own controller follows the path, or somebody drives. Needs --field both or occupancy
    #[arg(long)]
    explore: bool,
    /// Box to explore: two corners in the map frame, metres [default: 50 m to the sides of where exploring begins, 0.7 m below and 1 m above]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = corners, allow_hyphen_values = true, requires = "explore")]
    explore_bounds: Option<Corners>,
    /// The robot follows the floor, with its lidar so high above it, metres; without this it flies
    #[arg(long, value_name = "M", value_parser = height, requires = "explore")]
    explore_height: Option<f64>,
    /// Radius of the robot's body, metres
    #[arg(long, value_name = "M", default_value_t = 0.3, value_parser = radius, requires = "explore")]
    explore_radius: f64,
    /// Speed of the robot, metres per second
    #[arg(long, value_name = "M/S", default_value_t = 1.0, value_parser = speed, requires = "explore")]
    explore_speed: f64,
    /// Time until the robot must be at home again, where exploring began, seconds of the scans' time stamps [default: any]
    #[arg(long, value_name = "S", value_parser = seconds, requires = "explore")]
    explore_time: Option<f64>,
}

fn height(text: &str) -> Result<f64, String> {
    within(text, 0.1, 5.0, "metres")
}

impl ExploringArgs {
    /// What is to be planned with the settings of the map, if anything; then space counts as free where the robot is, as far as the sensor does not see the floor and what is above. `is_published` says
    /// whether anybody can get the plans.
    pub fn prepare(&self, settings: &mut Settings, is_published: bool) -> anyhow::Result<Option<PlannerSettings>> {
        if !self.explore {
            return Ok(None);
        }
        if settings.field == FieldKind::Tsdf {
            return Err(Failure::usage(
                "--explore needs to know what is free and what is unknown".to_owned(),
                "add --field both, or --field occupancy",
            )
            .into());
        }
        if !is_published {
            return Err(Failure::usage("what --explore plans would go nowhere".to_owned(), "add --ros2 or --foxglove").into());
        }
        let max_range = f64::from(settings.max_range);
        if settings.robot_radius == RobotRadius::Auto {
            let view = SensorView::of([], max_range);
            let (radius, voxel) = (self.explore_radius + MARGIN, f64::from(settings.voxel_size));
            settings.robot_radius = RobotRadius::Metres(view.own_radius(radius, voxel, self.explore_height) as f32);
            if settings.robot_height == RobotRadius::Auto {
                settings.robot_height = RobotRadius::Metres(view.own_height(radius, voxel, self.explore_height) as f32);
            }
        }
        let corners = self.explore_bounds.map(|corners| corners.local(Origin::default()));
        Ok(Some(PlannerSettings {
            radius: self.explore_radius,
            margin: MARGIN,
            height: self.explore_height,
            speed: self.explore_speed,
            bounds: corners.map(|bounds| [bounds.min, bounds.max].map(|corner| corner.map(f64::from))),
            time: self.explore_time,
            max_range,
            least_volume: LEAST_VOLUME,
        }))
    }
}
