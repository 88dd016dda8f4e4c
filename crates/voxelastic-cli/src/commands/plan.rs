//! `voxelastic plan`: a path for a robot through a map.

pub mod file;
mod picture;
mod recheck;

use crate::failure::{self, Failure};
use crate::map_files;
use crate::{commands, meshing, output};
use anyhow::Context;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, UnknownAs};
use voxelastic_plan::{PlanError, Point, Request, Robot, Wheels, plan, sharpest_turn};

/// Plan a path through a map that touches nothing
///
/// RRT-Connect or a search over a lattice finds a first path, RRT* shorter ones as long as there is time; the best is pulled tight and made
/// round. The robot is a ball that flies, or with --ground one that keeps its height over the floor.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic plan mine.vox --start 0,0,0.9 --goal 76,76,0.9 -o path.json --picture path.png
  voxelastic plan mine.vox --start 0,0,0.9 --goal 76,76,0.9 --ground -o path.json      on wheels, 0.9 m over the floor
  voxelastic plan hall.vox --start 0,0,0 --goal 9,3,1 --radius 0.2 --unknown free --time 5 -o path.json
  voxelastic plan mine.vox --recheck path.json          does it still hold, after more scans or corrections? Where not?")]
pub struct PlanArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// Where the robot's centre is, map frame, metres
    #[arg(long, value_name = "X,Y,Z", value_parser = commands::render::point, allow_hyphen_values = true, required_unless_present = "recheck")]
    start: Option<[f64; 3]>,
    /// Where it is to go
    #[arg(long, value_name = "X,Y,Z", value_parser = commands::render::point, allow_hyphen_values = true, required_unless_present = "recheck")]
    goal: Option<[f64; 3]>,
    /// Radius of the ball around the centre that must stay free, metres
    #[arg(long, allow_negative_numbers = true, value_name = "M", default_value_t = 0.35, value_parser = length)]
    radius: f64,
    /// Keep to the floor that the map shows, as wheels do
    #[arg(long)]
    ground: bool,
    /// Height of a wheeled robot's centre over the floor, metres [default: that of the start, or as low as the radius allows]
    #[arg(long, value_name = "M", requires = "ground", value_parser = length)]
    height: Option<f64>,
    /// Largest step of the floor that wheels take within 0.25 m, metres
    #[arg(long, value_name = "M", requires = "ground", default_value_t = 0.2, value_parser = length)]
    step: f64,
    /// What unknown space counts as
    #[arg(long, value_enum, default_value_t = Unknown::Occupied)]
    unknown: Unknown,
    /// Seconds to look for a path, and then for shorter ones
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = seconds)]
    time: f64,
    /// Stop after this many samples: a limit met before the time gives the same path on every machine
    #[arg(long, value_name = "N")]
    samples: Option<usize>,
    /// Seed of the random samples
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Keep the robot's centre in this box: two corners of the map frame, metres [default: all that is known]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = commands::slice::corners, allow_hyphen_values = true)]
    bounds: Option<Aabb>,
    /// The path and how it was found, as JSON
    #[arg(short, long, value_name = "FILE.json", required_unless_present = "recheck")]
    output: Option<PathBuf>,
    /// Do not plan, but look again at a path that was written before, where its waypoints are now, and say which parts are blocked; the exit
    /// code is then 1
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["start", "goal", "output", "picture"])]
    recheck: Option<PathBuf>,
    /// A picture: the map at the path's height, the tree red, the path blue, its start green and its goal red
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// Threads to draw the picture with; 0 for all cores. Nothing depends on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: the file without path, tree and anchors, but with their sizes
    #[arg(long)]
    json: bool,
}

/// What unknown space counts as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Unknown {
    /// Something to stay out of
    Occupied,
    /// Free
    Free,
}

fn length(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=100.0).contains(v)).ok_or_else(|| "must be 0 to 100 metres".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=86_400.0).contains(v)).ok_or_else(|| "must be 0 to 86400 seconds".to_owned())
}

/// What was planned, in short.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    output: &'a Path,
    #[serde(skip_serializing_if = "Option::is_none")]
    picture: Option<&'a Path>,
    #[serde(flatten)]
    figures: &'a file::Figures,
    waypoints: usize,
    tree_nodes: usize,
}

/// Plans the path.
pub fn run(args: &PlanArgs) -> anyhow::Result<u8> {
    let map = map_files::load(&args.map)?;
    let query = AtlasQuery::new(&map.atlas, map.settings.voxel);
    if let Some(file) = &args.recheck {
        return recheck::run(args, file, &map.atlas, &query);
    }
    let (Some(start), Some(goal), Some(output)) = (args.start, args.goal, &args.output) else { anyhow::bail!("start, goal and output are missing") };
    let request = args.request(start, goal);
    let found = plan(&query, &request).map_err(|error| explain(args, error))?;
    let figures = file::Figures::new(&request, &found);
    let path = file::PathFile::new(&args.map, &map.atlas, &found, figures);
    write(output, &path)?;
    if let Some(to) = &args.picture {
        meshing::pool(args.threads)?.install(|| picture::draw(to, &query, &request, &found))?;
    }
    let (figures, waypoints, tree_nodes) = (&path.figures, found.path.len(), found.tree.len());
    let turn = sharpest_turn(&found.path);
    tracing::info!(
        "{:.2} m, {:.2} m from the nearest obstacle, no turn sharper than {turn:.0} degrees; first path after {:.0} ms, {} samples in {:.2} s",
        found.length,
        found.least_clearance,
        1e3 * found.first.seconds,
        found.samples,
        found.seconds
    );
    tracing::info!("wrote {}", output.display());
    if args.json {
        output::print_json(&Summary { output, picture: args.picture.as_deref(), figures, waypoints, tree_nodes })?;
    }
    Ok(failure::DONE)
}

impl PlanArgs {
    fn robot(&self) -> Robot {
        let unknown = if self.unknown == Unknown::Free { UnknownAs::Free } else { UnknownAs::Blocked };
        let ground = self.ground.then_some(Wheels { height: self.height, step: Some(self.step) });
        Robot { radius: self.radius, unknown, ground }
    }

    fn request(&self, start: Point, goal: Point) -> Request {
        Request {
            bounds: self.bounds.map(|b| [b.min.map(f64::from), b.max.map(f64::from)]),
            time: Duration::from_secs_f64(self.time),
            samples: self.samples,
            seed: self.seed,
            ..Request::new(start, goal, self.robot())
        }
    }
}

/// What went wrong, with what to do about it.
fn explain(args: &PlanArgs, error: PlanError) -> anyhow::Error {
    let message = format!("{}: {error}", args.map.display());
    let failure = match error {
        PlanError::NoOccupancy => Failure::new(message, "map the scans with --field occupancy or --field both"),
        PlanError::Setting { .. } => Failure::usage(error.to_string(), "`voxelastic plan --help` shows what every option means"),
        PlanError::Blocked { nearest: Some([x, y, z]), end, .. } => Failure::new(message, format!("try --{end} {x:.2},{y:.2},{z:.2}")),
        PlanError::OutsideMap { .. } | PlanError::Blocked { .. } => {
            Failure::new(message, "choose another place (`voxelastic slice` shows the map), a smaller --radius, or --unknown free")
        }
        _ => Failure::new(message, "give it more --time, a smaller --radius or --unknown free; `voxelastic slice` shows what is in the way"),
    };
    failure.into()
}

fn write(path: &Path, content: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string(content).context("cannot write the path as JSON")?;
    let part = path.with_extension("json.part");
    let written = std::fs::write(&part, text + "\n").and_then(|()| std::fs::rename(&part, path));
    written.with_context(|| format!("cannot write {}", path.display()))
}
