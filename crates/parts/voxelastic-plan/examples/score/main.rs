//! Quality of paths: plans between random positions in the map of a simulated world and compares the paths with the world itself.
//!
//! ```sh
//! voxelastic simulate mine -o mine --drift 0
//! voxelastic map mine -o mine.vox --poses groundtruth.tum --field occupancy
//! cargo run --release -p voxelastic-plan --example score -- mine mine.vox
//! cargo run --release -p voxelastic-plan --example score -- campus campus.vox --ground 0.9
//! ```
//!
//! Options: `--pairs N` (100), `--radius M` (0.35), `--time S` (1), `--seed N` (1), `--ground M` (wheeled, centre at this height),
//! `--low M`, `--high M` (limits of the centre's height), `--planner ours|oxmpl-connect|oxmpl-star`, `--verbose`, `--only N` (only this pair).
//!
//! Pairs without a path in the true world are left out. The reference of a pair is the shortest path on a grid of the true world, shortened there with
//! exact sweeps, or our own path shortened in the true world if that is shorter. The map does not contain all of the world, so a second reference is
//! computed in the map: `exists_in_map`, and the length over that reference. A collision is a path along which the true distance falls below
//! the radius minus one voxel. `seconds` shows how precisely the limit of time is kept.
#![allow(clippy::print_stderr)]

mod other;
mod truth;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use std::time::{Duration, Instant};
use truth::{Grid, Truth};
use voxelastic::atlas::Atlas;
use voxelastic::query::{AtlasQuery, UnknownAs};
use voxelastic_io::store::MapStore;
use voxelastic_plan::{Effort, FlyingSpace, GroundSpace, Plan, Point, Request, Robot, Space, Wheels, length, plan, shorten};
use voxelastic_sim::World;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

struct Options {
    pairs: usize,
    radius: f64,
    time: f64,
    seed: u64,
    ground: Option<f64>,
    low: f64,
    high: f64,
    planner: String,
    only: Option<usize>,
    verbose: bool,
}

fn options(arguments: &[String]) -> Result<Options> {
    let mut options = Options {
        pairs: 100,
        radius: 0.35,
        time: 1.0,
        seed: 1,
        ground: None,
        low: 0.0,
        high: 4.0,
        planner: "ours".into(),
        only: None,
        verbose: false,
    };
    let mut rest = arguments.iter();
    while let Some(key) = rest.next() {
        if key == "--verbose" {
            options.verbose = true;
            continue;
        }
        let value = rest.next().ok_or(format!("{key} has no value"))?;
        match key.as_str() {
            "--pairs" => options.pairs = value.parse()?,
            "--radius" => options.radius = value.parse()?,
            "--time" => options.time = value.parse()?,
            "--seed" => options.seed = value.parse()?,
            "--ground" => options.ground = Some(value.parse()?),
            "--low" => options.low = value.parse()?,
            "--high" => options.high = value.parse()?,
            "--only" => options.only = Some(value.parse()?),
            "--planner" => options.planner.clone_from(value),
            _ => return Err(format!("there is no option {key}").into()),
        }
    }
    Ok(options)
}

/// Result of one pair.
struct Score {
    found: bool,
    first_s: f64,
    seconds: f64,
    /// Processor time.
    cpu_s: f64,
    length: f64,
    reference: f64,
    /// Length of the shortest path in the map, metres; NaN where there is none.
    in_map: f64,
    /// Least true distance to the world along the path, metres.
    least: f64,
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [world, map, rest @ ..] = arguments.as_slice() else { return Err("give the simulation's folder and the map".into()) };
    let options = options(rest)?;
    let world = World::load(world)?;
    let store = MapStore::open(map)?;
    let voxel: f32 = store.manifest().details.settings.get("voxel_size").ok_or("the map does not say how large its voxels are")?.parse()?;
    // The planners of oxmpl require a map with a static lifetime.
    let atlas: &'static Atlas = Box::leak(Box::new(store.load_atlas()?));
    let begun = Instant::now();
    let query: &'static AtlasQuery<'static> = Box::leak(Box::new(atlas.query().unwrap()));
    let known = query.bounds();
    eprintln!(
        "{} submaps, query made in {:.1} ms, known {:?} to {:?}",
        atlas.submaps().len(),
        1e3 * begun.elapsed().as_secs_f64(),
        known.min,
        known.max
    );
    let mut bounds = [known.min.map(f64::from), known.max.map(f64::from)];
    (bounds[0][2], bounds[1][2]) = (options.low.max(bounds[0][2]), options.high.min(bounds[1][2]));
    let ground = options.ground.map(|height| Wheels { height: Some(height), step: None });
    let robot = Robot { radius: options.radius, unknown: UnknownAs::Blocked, ground };
    // On the ground the reference is the path of a ball at its height above level ground.
    let heights = options.ground.map_or([bounds[0][2], bounds[1][2]], |height| [height - 0.1, height + 0.3]);
    let [low, high] = bounds;
    let truth = Truth { world: &world, radius: options.radius, bounds: [[low[0], low[1], heights[0]], [high[0], high[1], heights[1]]] };

    let begun = Instant::now();
    let scores = match options.ground {
        Some(height) => run(Box::leak(Box::new(GroundSpace::new(query, &robot, [0.0, 0.0, height], bounds)?)), query, &truth, &robot, &options),
        None => run(Box::leak(Box::new(FlyingSpace::new(query, &robot, bounds))), query, &truth, &robot, &options),
    };
    report(&scores, &options, f64::from(voxel));
    eprintln!("{:.0} s in all", begun.elapsed().as_secs_f64());
    Ok(())
}

/// A random position where the robot fits in the map and in the world.
fn random_state<S: Space>(space: &S, truth: &Truth<'_>, random: &mut StdRng) -> Point {
    loop {
        let [low, high] = space.bounds();
        let p: Point = std::array::from_fn(|k| random.random_range(low[k]..high[k]));
        if let Some(p) = space.state_at(p).filter(|p| truth.state_at(*p).is_some()) {
            return p;
        }
    }
}

fn run<S: Space>(space: &'static S, query: &AtlasQuery<'_>, truth: &Truth<'_>, robot: &Robot, options: &Options) -> Vec<Score> {
    let mut random = StdRng::seed_from_u64(options.seed);
    let edge = if options.ground.is_some() { 0.1 } else { 0.25 };
    let (mut grid, mut map_grid) = (Grid::new(truth, options.ground, edge), Grid::new(space, options.ground, edge));
    let mut scores = Vec::new();
    let (mut unconnected, mut count) = (0, 0);
    while count < options.pairs {
        let (start, goal) = (random_state(space, truth, &mut random), random_state(space, truth, &mut random));
        let Some(path) = grid.search(start, goal) else {
            unconnected += 1;
            continue;
        };
        count += 1;
        if options.only.is_some_and(|only| only != count) {
            continue;
        }
        let reference = length(&shorten(truth, path, Effort::Thorough));
        let in_map = map_grid.search(start, goal).map_or(f64::NAN, |path| length(&shorten(space, path, Effort::Thorough)));
        let request = Request {
            bounds: Some(space.bounds()),
            time: Duration::from_secs_f64(options.time),
            seed: options.seed + count as u64 - 1,
            ..Request::new(start, goal, *robot)
        };
        let (begun, cpu) = (Instant::now(), cpu_time());
        let planned = match options.planner.as_str() {
            "ours" => plan(query, &request).map_err(|e| e.to_string()),
            name => other::plan(space, &request, name),
        };
        let (seconds, cpu_s) = (begun.elapsed().as_secs_f64(), cpu_time() - cpu);
        let score = match planned {
            Ok(plan) => Score { cpu_s, in_map: in_map.min(plan.length), ..score(&plan, truth, reference, seconds) },
            Err(problem) => {
                eprintln!("{:?} to {:?}: {problem}", start, goal);
                Score { found: false, first_s: seconds, seconds, cpu_s, length: f64::NAN, reference, in_map, least: f64::NAN }
            }
        };
        if options.verbose {
            let Score { first_s, length, reference, in_map, least, .. } = score;
            eprintln!(
                "{:4} {start:.1?} to {goal:.1?}: first {:.0} ms, {length:.1} m, reference {reference:.1} m ({:.3}), in the map {in_map:.1} m, true distance {least:.3} m",
                count,
                1e3 * first_s,
                length / reference
            );
        }
        scores.push(score);
    }
    eprintln!("{unconnected} pairs left out: no path in the true world");
    scores
}

fn cpu_time() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 + 1e-9 * t.tv_nsec as f64
}

fn score(plan: &Plan, truth: &Truth<'_>, reference: f64, seconds: f64) -> Score {
    let least = plan.path.windows(2).map(|w| truth.least(w[0], w[1], 0.0)).fold(f64::INFINITY, f64::min);
    let is_free = plan.path.windows(2).all(|w| truth.connects(w[0], w[1]));
    let tight = if is_free { length(&shorten(truth, plan.path.clone(), Effort::Thorough)) } else { f64::INFINITY };
    Score {
        found: true,
        first_s: plan.first.seconds,
        seconds,
        cpu_s: 0.0,
        length: plan.length,
        reference: reference.min(tight),
        in_map: f64::NAN,
        least,
    }
}

fn report(scores: &[Score], options: &Options, voxel: f64) {
    let found: Vec<&Score> = scores.iter().filter(|s| s.found).collect();
    let rank = |values: Vec<f64>, share: f64| {
        let mut sorted = values;
        sorted.sort_by(f64::total_cmp);
        sorted.get(((sorted.len() as f64 * share).ceil() as usize).saturating_sub(1)).copied().unwrap_or(f64::NAN)
    };
    let all = |f: fn(&Score) -> f64| -> Vec<f64> { found.iter().map(|s| f(s)).collect() };
    let ratio = |s: &Score| s.length / s.reference;
    let in_map = |s: &Score| s.length / s.in_map;
    let collisions = found.iter().filter(|s| s.least < options.radius - voxel).count();
    let summary = serde_json::json!({
        "planner": options.planner, "pairs": scores.len(), "exists_in_map": scores.iter().filter(|s| s.in_map.is_finite()).count(),
        "found": found.len(), "collisions": collisions,
        "least_true_distance_m": rank(all(|s| s.least), 0.0),
        "length_over_reference": { "median": rank(all(ratio), 0.5), "p95": rank(all(ratio), 0.95), "max": rank(all(ratio), 1.0),
            "within_5_percent": found.iter().filter(|s| ratio(s) <= 1.05).count() },
        "no_way_in_map_within_5_percent_of_reference": scores.iter().filter(|s| s.in_map > 1.05 * s.reference || s.in_map.is_nan()).count(),
        "length_over_reference_in_map": { "median": rank(all(in_map), 0.5), "p95": rank(all(in_map), 0.95), "max": rank(all(in_map), 1.0),
            "within_5_percent": found.iter().filter(|s| in_map(s) <= 1.05).count() },
        "first_path_ms": { "median": 1e3 * rank(all(|s| s.first_s), 0.5), "p95": 1e3 * rank(all(|s| s.first_s), 0.95), "max": 1e3 * rank(all(|s| s.first_s), 1.0) },
        // Share of the wall time that the process ran; the first path's processor time is estimated with it.
        "processor_share": found.iter().map(|s| s.cpu_s).sum::<f64>() / found.iter().map(|s| s.seconds).sum::<f64>(),
        "first_path_cpu_ms": { "median": 1e3 * rank(all(|s| s.first_s * s.cpu_s / s.seconds), 0.5), "p95": 1e3 * rank(all(|s| s.first_s * s.cpu_s / s.seconds), 0.95) },
        "seconds": { "median": rank(all(|s| s.seconds), 0.5), "max": rank(all(|s| s.seconds), 1.0) },
        "reference_m": { "median": rank(all(|s| s.reference), 0.5), "max": rank(all(|s| s.reference), 1.0) },
    });
    #[expect(clippy::print_stdout, reason = "the figures are what this program is for")]
    {
        println!("{summary:#}");
    }
}
