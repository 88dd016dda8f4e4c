//! `voxelastic simulate`: writes simulated scans of an exactly known world as a dataset folder.

use crate::failure::{self, Failure};
use crate::progress::Progress;
use crate::{interrupt, output};
use anyhow::Context;
use clap::Args;
use nalgebra::{Translation3, UnitQuaternion};
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;
use voxelastic::Pose;
use voxelastic_run::threads::pool;
use voxelastic_sim::camera::Lens;
use voxelastic_sim::dataset::{Folder, Outcome};
use voxelastic_sim::drift::LoopSettings;
use voxelastic_sim::imu::ImuSettings;
use voxelastic_sim::route::Carrier;
use voxelastic_sim::sensor::{LidarSettings, Noise};
use voxelastic_sim::{SecondLidar, SimError, SimOptions, Simulation};

/// Simulate a LiDAR in an exactly known world and write a folder to map and to evaluate against
///
/// Worlds: campus (a college quad, a narrow tunnel, a 1 m doorway, a park; 135 x 225 m), mine (rooms and corridors hewn from rock), street (a
/// drive around a block of houses), tunnel (300 m without features), to explore maze (corridors with dead ends) and district (a square kilometre
/// of streets, houses, yards and parks), and for tests room, plane and sphere. The sensor follows a closed route, lap after lap; in the maze it
/// stays at its start.
///
/// --moving --rate 10 makes sweeps as a turning sensor records them: each column has its own time and pose. With --imu there are samples of an
/// inertial measurement unit, too, and with --bag all of it is one recording instead of a folder of scans.
///
/// The folder contains organised scans (PCD), drifting poses of odometry (poses.tum), poses corrected after loop closures (poses@NNNNNN.txt),
/// the true poses (groundtruth.tum), the pose graph (graph.g2o), and world.toml, from which `voxelastic eval` rebuilds the world. The same
/// options give the same folder. An existing simulated folder is replaced; any other folder that is not empty is refused.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic simulate campus -o campus                  follows the route and writes the folder campus
  voxelastic map campus                                 maps it with drifting poses and their corrections
  voxelastic eval campus.vox --truth campus             measures the map against the world
  voxelastic map campus -o true.vox --poses groundtruth
  voxelastic simulate street -o street --laps 3 --spacing 1 --moving
  voxelastic simulate mine -o mine --sensor os0-128 --columns 512 --drift 2 --seed 7
  voxelastic simulate campus -o walk --carrier handheld --rest 3 --moving --rate 10 --scans 600 --imu 100 --bag
  voxelastic simulate campus -o livox --sensor avia --spacing 0.5 --scans 400
  voxelastic simulate street -o two --bag --second-lidar vlp-16
  voxelastic simulate street -o thin --thin 0.3         as SLAM systems keep their clouds
  voxelastic simulate campus -o seen --camera           with images of a camera, to colour the mesh
  voxelastic simulate room -o room --scans 10 --columns 256 --noise 0")]
pub struct SimulateArgs {
    /// The world
    #[arg(value_name = "WORLD", value_parser = clap::builder::PossibleValuesParser::new(voxelastic_sim::scenes::names().collect::<Vec<_>>()))]
    world: String,
    /// The folder to write
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Number of scans [default: enough to cover the world and to revisit places]
    #[arg(long, value_name = "N", conflicts_with = "laps")]
    scans: Option<usize>,
    /// Laps of the route, instead of a number of scans; 0.5 for half a lap
    #[arg(long, value_name = "N", value_parser = laps)]
    laps: Option<f64>,
    /// Distance between two scans, metres
    #[arg(long, value_name = "M", default_value_t = 2.0)]
    spacing: f64,
    /// Scans per second, instead of a distance between them
    #[arg(long, value_name = "HZ", conflicts_with = "spacing")]
    rate: Option<f64>,
    /// The sensor, one of those of `voxelastic map --sensor`, or avia or mid-360 (Livox), whose beams never repeat
    #[arg(long, value_name = "NAME", default_value = "os1-64")]
    sensor: String,
    /// Columns per revolution [default: that of the sensor, 1024 for os1-64]
    #[arg(long, value_name = "N")]
    columns: Option<usize>,
    /// A second sensor beside the first, by name, whose clouds are a topic of their own in the recording (with --bag)
    #[arg(long, value_name = "NAME", requires = "bag")]
    second_lidar: Option<String>,
    /// Pose of the second sensor in the frame of the first [default: 0.6 m behind and 0.3 m below it, turned back and 40 degrees down]
    #[arg(long, value_name = "\"X Y Z QX QY QZ QW\"", value_parser = crate::args::data::pose, allow_hyphen_values = true, requires = "second_lidar")]
    second_pose: Option<Pose>,
    /// Thin the clouds as SLAM systems do: one point, the mean, in each cube of this edge, metres
    #[arg(long, value_name = "M")]
    thin: Option<f64>,
    /// Maximum range, metres
    #[arg(long, value_name = "M", default_value_t = 120.0)]
    max_range: f64,
    /// Factor on the noise of the sensor (1 cm near, 3 cm at 100 m, lost returns, mixed pixels at edges); 0 for exact ranges
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    noise: f64,
    /// Move the sensor during a sweep: each column has its own time and pose
    #[arg(long)]
    moving: bool,
    /// Who carries the sensor: pedestrian, handheld (shaken, and swung by up to 90 degrees/s), robot or car [default: that of the world]
    #[arg(long, value_name = "NAME", value_parser = clap::builder::PossibleValuesParser::new(Carrier::names().collect::<Vec<_>>()))]
    carrier: Option<String>,
    /// Seconds for which the sensor stands still at first
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    rest: f64,
    /// Cars and walkers that move through the world, parked cars that leave and gates that open; each point has a label then (labels/NNNNNN.label: 0 the
    /// world, 1 what moves, 2 what stands and moves later, 3 what has moved and stands)
    #[arg(long, value_name = "N", default_value_t = 0)]
    traffic: usize,
    /// Samples per second of an inertial measurement unit with noise and biases, which is next to the sensor and turned by half a turn
    #[arg(long, value_name = "HZ")]
    imu: Option<f64>,
    /// A camera beside the sensor, which takes an image after each scan, with an exposure of its own: wide (90 degrees across) or fisheye (170 degrees)
    #[arg(long, value_name = "LENS", num_args = 0..=1, default_missing_value = "wide", value_parser = clap::builder::PossibleValuesParser::new(Lens::NAMES))]
    camera: Option<String>,
    /// Write a ROS 2 recording (recording.mcap: /points, /points_2, /imu, /front/image/compressed, /front/camera_info, /tf_static) instead of a folder of scans
    #[arg(long)]
    bag: bool,
    /// Drift of the odometry, metres per 100 m of path; 0 for none
    #[arg(long, value_name = "M", default_value_t = 1.0)]
    drift: f64,
    /// Largest distance to an earlier pose that closes a loop, metres; 0 for no loops
    #[arg(long, value_name = "M", default_value_t = 5.0)]
    loop_radius: f64,
    /// Random seed, of furniture, noise and drift
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Number of threads; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: scans, path, loop closures, seconds, ..
    #[arg(long)]
    json: bool,
}

fn laps(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|n: &f64| *n > 0.0 && *n <= 1e4).ok_or_else(|| "must be a number above 0, at most 10000".to_owned())
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(serialize_with = "crate::output::path")]
    output: PathBuf,
    world: String,
    /// Scans written.
    scans: usize,
    interrupted: bool,
    /// Length of the true path over all requested scans, metres.
    path_m: f64,
    /// Loop closures.
    loop_edges: usize,
    /// Largest distance between true and odometry pose, metres.
    largest_drift_m: f64,
    total_s: f64,
    scans_per_s: f64,
}

/// Runs the command.
pub fn run(args: &SimulateArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    let pool = pool(args.threads)?;
    let folder = Folder::claim(&args.output).map_err(explain)?;
    let simulation = pool.install(|| options(args).and_then(Simulation::new)).map_err(explain)?;
    interrupt::install("finishing the current scans");

    let mut progress = Progress::new("scans", simulation.len() as u64, quiet);
    let mut reported = 0;
    let mut report = |written: usize, _: usize| {
        (reported..written).for_each(|_| progress.step(|| format!("{} loop closures", simulation.loop_edges().len())));
        reported = written;
        if interrupt::requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let write =
        || if args.bag { simulation.write_as_recording(folder.target(), &mut report) } else { simulation.write(folder.target(), &mut report) };
    let scans = pool.install(write).context("cannot write the simulation")?;
    drop(progress);
    let interrupted = scans < simulation.len();
    let folder_kept = folder.finish(interrupted)? == Outcome::Kept;

    let total_s = clock.elapsed().as_secs_f64();
    let summary = summarise(args, &simulation, scans, total_s);
    let Summary { path_m, loop_edges, largest_drift_m, .. } = summary;
    tracing::info!("{scans} scans on {path_m:.0} m with {loop_edges} loop closures in {total_s:.1} s; odometry drifts up to {largest_drift_m:.2} m");
    if folder_kept {
        tracing::warn!("{}: the existing simulation is kept", args.output.display());
    } else {
        tracing::info!("wrote {}", args.output.display());
    }
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(if summary.interrupted { failure::INTERRUPTED } else { failure::DONE })
}

fn summarise(args: &SimulateArgs, simulation: &Simulation, scans: usize, total_s: f64) -> Summary {
    let (truth, odometry) = (simulation.ground_truth(), simulation.odometry());
    let apart = |a: &Pose, b: &Pose| (a.translation.vector - b.translation.vector).norm();
    Summary {
        output: args.output.clone(),
        world: args.world.clone(),
        scans,
        interrupted: scans < simulation.len(),
        path_m: truth.windows(2).map(|w| apart(&w[0], &w[1])).sum(),
        loop_edges: simulation.loop_edges().len(),
        largest_drift_m: truth.iter().zip(odometry).map(|(a, b)| apart(a, b)).fold(0.0, f64::max),
        total_s,
        scans_per_s: scans as f64 / total_s.max(1e-9),
    }
}

/// The options of the simulation.
fn options(args: &SimulateArgs) -> Result<SimOptions, SimError> {
    let mut options = SimOptions {
        seed: args.seed,
        sensor: args.sensor.clone(),
        columns: args.columns,
        second: args.second_lidar.as_ref().map(|sensor| second(sensor, args)),
        thin: args.thin,
        scans: args.scans,
        spacing: args.spacing,
        rate: args.rate,
        drift: args.drift,
        lidar: LidarSettings {
            max_range: args.max_range,
            moving: args.moving,
            noise: Noise::default().times(args.noise),
            ..LidarSettings::default()
        },
        loops: LoopSettings { radius: args.loop_radius, ..LoopSettings::default() },
        carrier: args.carrier.clone(),
        rest: args.rest,
        traffic: args.traffic,
        camera: args.camera.as_deref().and_then(Lens::named),
        imu: args.imu.map(|rate| ImuSettings { rate, ..ImuSettings::default() }),
        ..SimOptions::of(&args.world)
    };
    if let Some(laps) = args.laps {
        let trajectory = options.scene()?.trajectory;
        let spacing = args.rate.map_or(args.spacing, |rate| trajectory.carrier.speed / rate);
        // An invalid spacing gives an invalid number of scans, and is rejected later.
        options.scans = Some(((laps * trajectory.route.length() / spacing).ceil() as usize).saturating_add(1));
    }
    Ok(options)
}

/// The second sensor.
fn second(sensor: &str, args: &SimulateArgs) -> SecondLidar {
    // Towards the back, where the first one's carrier hides the ground.
    let down = UnitQuaternion::from_euler_angles(0.0, 40f64.to_radians(), std::f64::consts::PI);
    let pose = args.second_pose.unwrap_or_else(|| Pose::from_parts(Translation3::new(-0.6, 0.0, -0.3), down));
    let (t, q) = (&pose.translation, &pose.rotation.coords);
    SecondLidar { sensor: sensor.to_owned(), columns: args.columns, position: [t.x, t.y, t.z], rotation: [q.x, q.y, q.z, q.w] }
}

/// Turns errors of options into usage errors, and says what helps.
fn explain(error: SimError) -> anyhow::Error {
    match error {
        SimError::Setting { .. } | SimError::UnknownWorld { .. } | SimError::UnknownCarrier { .. } | SimError::Sensor(_) => {
            Failure::usage(error.to_string(), "see `voxelastic simulate --help`").into()
        }
        SimError::NoFolder { .. } | SimError::NotSimulated { .. } => {
            Failure::new(error.to_string(), "name another folder with -o, or empty this one first").into()
        }
        other => other.into(),
    }
}
