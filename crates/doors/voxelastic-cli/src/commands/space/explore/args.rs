//! Arguments of `voxelastic explore`.

use crate::commands;
use crate::commands::space::slice::Corners;
use crate::failure::Failure;
use clap::Args;
use std::path::PathBuf;
use voxelastic::query::UnknownAs;
use voxelastic::sensor::{BeamModel, preset};
use voxelastic_explore::{ExploreSettings, SensorView};
use voxelastic_io::Origin;
use voxelastic_plan::{Point, Robot, Wheels};
use voxelastic_sim::World;

/// What the planner keeps beyond the robot's body, metres: the robot is not exactly where it thinks.
pub const MARGIN: f64 = 0.1;

/// Explore a simulated world: a robot maps what it sees, decides where to go next, and comes home
///
/// It flies, or rolls with --ground. Its odometry drifts; loops close on the way, and map, path and plans move with the corrections. It goes where its sensor would see most
/// unknown space soon, and turns back in time. The result is compared with the world: how much of the space it could see is known, and whether it touched anything.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic explore maze --picture maze.png --report maze.html
  voxelastic explore mine --ground --time 900 --json
  voxelastic explore campus --seed 3 --drift 2 --json
  for seed in 1 2 3 4 5 6 7 8 9 10; do voxelastic explore mine --seed $seed --json --quiet; done")]
pub struct ExploreArgs {
    /// The world
    #[arg(value_name = "WORLD", value_parser = clap::builder::PossibleValuesParser::new(voxelastic_sim::scenes::names().collect::<Vec<_>>()))]
    pub world: String,
    /// Seed of the world, of the noise and of the drift
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Follow the floor, for robots on wheels
    #[arg(long)]
    pub ground: bool,
    /// Time until the robot must be at home, seconds of the simulation
    #[arg(long, value_name = "S", default_value_t = 600.0, value_parser = seconds)]
    pub time: f64,
    /// Speed of the robot, metres per second
    #[arg(long, value_name = "M/S", default_value_t = 2.0, value_parser = speed)]
    pub speed: f64,
    /// Radius of the robot's body, metres
    #[arg(long, value_name = "M", default_value_t = 0.3, value_parser = radius)]
    pub radius: f64,
    /// Drift of the odometry, metres in 100 m; 0 for none
    #[arg(long, value_name = "M", default_value_t = 2.0, value_parser = drift)]
    pub drift: f64,
    /// The sensor, one of those of `voxelastic map --sensor` [default: os1-64; on wheels os0-64, which sees the floor beside the robot]
    #[arg(long, value_name = "NAME")]
    pub sensor: Option<String>,
    /// Columns per revolution of the sensor
    #[arg(long, value_name = "N", default_value_t = 512)]
    pub columns: usize,
    /// Edge of the finest voxel, metres
    #[arg(long, value_name = "M", default_value_t = 0.1, value_parser = voxel)]
    pub voxel_size: f32,
    /// Largest range that is mapped, metres
    #[arg(long, value_name = "M", default_value_t = 30.0, value_parser = range)]
    pub max_range: f32,
    /// What a beam without return says: nothing, or, as under the sky, that there is free space up to the largest range
    #[arg(long, value_name = "unknown|free", default_value = "unknown", value_parser = ["unknown", "free"])]
    pub no_return: String,
    /// Distance between scans, metres
    #[arg(long, value_name = "M", default_value_t = 1.0, value_parser = range_wide)]
    pub spacing: f64,
    /// Box to explore: two corners in the map frame, metres [default: around the solids of the world, from 0.7 m below the start to 1 m above it]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = commands::space::slice::corners, allow_hyphen_values = true)]
    pub bounds: Option<Corners>,
    /// A picture to write: the map, the path, what is left of the frontier, and how much was known when
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// A report to write, one HTML page: the map, the path, frontier and plan at any moment, and how much was known when
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Threads to use; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Print one JSON object on stdout: share of the space known over time, distance, collisions, times of decisions
    #[arg(long)]
    pub json: bool,
}

/// Parses a number from `low` to `high`.
pub fn within(text: &str, low: f64, high: f64, unit: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (low..=high).contains(v)).ok_or_else(|| format!("must be {low} to {high} {unit}"))
}

/// Parses a time.
pub fn seconds(text: &str) -> Result<f64, String> {
    within(text, 1.0, 86_400.0, "seconds")
}

/// Parses a speed.
pub fn speed(text: &str) -> Result<f64, String> {
    within(text, 0.01, 100.0, "metres per second")
}

/// Parses the radius of a robot.
pub fn radius(text: &str) -> Result<f64, String> {
    within(text, 0.05, 2.0, "metres")
}

fn drift(text: &str) -> Result<f64, String> {
    within(text, 0.0, 20.0, "metres in 100 m")
}

fn voxel(text: &str) -> Result<f32, String> {
    within(text, 0.05, 1.0, "metres").map(|v| v as f32)
}

fn range(text: &str) -> Result<f32, String> {
    within(text, 2.0, 200.0, "metres").map(|v| v as f32)
}

fn range_wide(text: &str) -> Result<f64, String> {
    within(text, 0.1, 20.0, "metres")
}

/// What a sensor sees whose returns are mapped up to `max_range` metres, in voxels of `voxel_size` metres.
pub fn view(model: &BeamModel, max_range: f32, voxel_size: f32) -> SensorView {
    let view = SensorView::of(model.elevations().iter().copied().map(f64::from), f64::from(max_range));
    view.resolving(f64::from(model.largest_gap()), f64::from(voxel_size))
}

impl ExploreArgs {
    /// Name of the sensor.
    pub fn sensor(&self) -> &str {
        self.sensor.as_deref().unwrap_or(if self.ground { "os0-64" } else { "os1-64" })
    }

    /// Settings of the explorer for a robot that starts at `start` in `world`.
    pub fn settings(&self, start: Point, world: &World) -> anyhow::Result<ExploreSettings> {
        let bounds = match (self.bounds, world.bounds()) {
            (Some(corners), _) => {
                let bounds = corners.local(Origin::default());
                [bounds.min.map(f64::from), bounds.max.map(f64::from)]
            }
            (None, Some((low, high))) => [[low[0], low[1], start[2] - 0.7], [high[0], high[1], start[2] + 1.0]],
            (None, None) => return Err(Failure::usage(format!("{} has no bounds", self.world), "give --bounds").into()),
        };
        let ground = self.ground.then_some(Wheels { height: Some(start[2]), step: None });
        let robot = Robot { radius: self.radius + MARGIN, unknown: UnknownAs::Blocked, ground };
        let model = preset(self.sensor()).map_err(|error| Failure::usage(error.to_string(), "see `voxelastic map --help` for the sensors"))?;
        let view = view(&model, self.max_range, self.voxel_size);
        Ok(ExploreSettings { margin: MARGIN, speed: self.speed, view, ..ExploreSettings::new(robot, bounds) })
    }
}
