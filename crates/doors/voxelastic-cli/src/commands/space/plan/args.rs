//! Arguments of `voxelastic plan`.

use crate::args::LoadArgs;
use crate::commands;
use crate::commands::space::slice::Corners;
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::time::Duration;
use voxelastic::query::UnknownAs;
use voxelastic_io::Origin;
use voxelastic_plan::{PlanError, Point, Request, Robot, Wheels};

/// Plan a collision-free path through a map
///
/// RRT-Connect or a lattice search finds a first path, RRT* improves it as long as there is time; the best path is shortened and smoothed.
/// The robot is a sphere that flies, or, with --ground, one that keeps its height above the floor.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic plan mine.vox --start 0,0,0.9 --goal 76,76,0.9 -o path.json --picture path.png
  voxelastic plan mine.vox --start 0,0,0.9 --goal 76,76,0.9 --ground -o path.json      on wheels, 0.9 m above the floor
  voxelastic plan hall.vox --start 0,0,0 --goal 9,3,1 --radius 0.2 --unknown free --time 5 -o path.json
  voxelastic plan mine.vox --recheck path.json          is the path still free, after more scans or corrections?")]
pub struct PlanArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    pub map: PathBuf,
    #[command(flatten)]
    pub load: LoadArgs,
    /// Start of the robot centre, map frame, metres
    #[arg(long, value_name = "X,Y,Z", value_parser = commands::render::point, allow_hyphen_values = true, required_unless_present = "recheck")]
    pub start: Option<[f64; 3]>,
    /// Goal of the robot centre, map frame, metres
    #[arg(long, value_name = "X,Y,Z", value_parser = commands::render::point, allow_hyphen_values = true, required_unless_present = "recheck")]
    pub goal: Option<[f64; 3]>,
    /// Radius of the sphere around the centre that must be free, metres
    #[arg(long, allow_negative_numbers = true, value_name = "M", default_value_t = 0.35, value_parser = length)]
    pub radius: f64,
    /// Follow the floor in the map, for robots on wheels
    #[arg(long)]
    pub ground: bool,
    /// Height of the centre of a robot on wheels above the floor, metres [default: that of the start, or as low as the radius allows]
    #[arg(long, value_name = "M", requires = "ground", value_parser = length)]
    pub height: Option<f64>,
    /// Largest step of the floor within 0.25 m that wheels can pass, metres
    #[arg(long, value_name = "M", requires = "ground", default_value_t = 0.2, value_parser = length)]
    pub step: f64,
    /// How unknown space is treated
    #[arg(long, value_enum, default_value_t = Unknown::Occupied)]
    pub unknown: Unknown,
    /// Planning time, seconds
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = seconds)]
    pub time: f64,
    /// Largest number of samples; if it is reached before the time, the path is the same on every machine
    #[arg(long, value_name = "N")]
    pub samples: Option<usize>,
    /// Seed of the random samples
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Box for the robot centre: two corners in the map frame, metres [default: the known space]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = commands::space::slice::corners, allow_hyphen_values = true)]
    pub bounds: Option<Corners>,
    /// The file to write: the path with its properties, as JSON
    #[arg(short, long, value_name = "FILE.json", required_unless_present = "recheck")]
    pub output: Option<PathBuf>,
    /// Do not plan, but check a path file in the present map, with its waypoints moved by corrections, and report blocked segments; the exit
    /// code is then 1
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["start", "goal", "output", "picture"])]
    pub recheck: Option<PathBuf>,
    /// A picture to write: the map at the height of the path, search tree, path, start and goal
    #[arg(long, value_name = "FILE.png")]
    pub picture: Option<PathBuf>,
    /// Number of threads for the picture; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Print one JSON object on stdout: the file without path, tree and anchors, but with their sizes
    #[arg(long)]
    pub json: bool,
}

/// Treatment of unknown space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Unknown {
    /// As occupied
    Occupied,
    /// As free
    Free,
}

fn length(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=100.0).contains(v)).ok_or_else(|| "must be 0 to 100 metres".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=86_400.0).contains(v)).ok_or_else(|| "must be 0 to 86400 seconds".to_owned())
}

impl PlanArgs {
    /// The robot.
    pub fn robot(&self) -> Robot {
        let unknown = if self.unknown == Unknown::Free { UnknownAs::Free } else { UnknownAs::Blocked };
        let ground = self.ground.then_some(Wheels { height: self.height, step: Some(self.step) });
        Robot { radius: self.radius, unknown, ground }
    }

    /// The request for a path from `start` to `goal` in the map frame, in the coordinates of a map with this origin.
    pub fn request(&self, start: Point, goal: Point, origin: Origin) -> Request {
        let [start, goal] = [start, goal].map(|point| origin.point_to_local(point));
        Request {
            bounds: self.bounds.map(|corners| corners.local(origin)).map(|b| [b.min.map(f64::from), b.max.map(f64::from)]),
            time: Duration::from_secs_f64(self.time),
            samples: self.samples,
            seed: self.seed,
            ..Request::new(start, goal, self.robot())
        }
    }
}

/// Adds a remedy to an error of the planner.
pub fn explain(args: &PlanArgs, error: PlanError) -> anyhow::Error {
    let message = format!("{}: {error}", args.map.display());
    let failure = match error {
        PlanError::NoOccupancy => Failure::new(message, "map the scans with --field occupancy or --field both"),
        PlanError::Setting { .. } => Failure::usage(error.to_string(), "see `voxelastic plan --help`"),
        PlanError::Blocked { nearest: Some([x, y, z]), endpoint, .. } => Failure::new(message, format!("try --{endpoint} {x:.2},{y:.2},{z:.2}")),
        PlanError::OutsideMap { .. } | PlanError::Blocked { .. } => {
            Failure::new(message, "choose another position (`voxelastic slice` draws the map), a smaller --radius, or --unknown free")
        }
        _ => Failure::new(message, "use more --time, a smaller --radius or --unknown free; `voxelastic slice` draws the obstacles"),
    };
    failure.into()
}
