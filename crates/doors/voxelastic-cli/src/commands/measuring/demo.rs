//! `voxelastic demo`: simulates a world, maps it, measures the map, draws it and writes a report, in about a minute.

mod figures;

use super::eval::truth::{Limits, Truth};
use super::eval::{EvalArgs, Field, Summary, measure_against};
use crate::args::LoadArgs;
use crate::commands::render;
use crate::failure::{self, Failure};
use crate::meshing::SurfaceArgs;
use crate::progress::Progress;
use crate::reporting::{self, Subject};
use crate::{interrupt, output};
use anyhow::Context;
use clap::Args;
use figures::{Figures, Row};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::event::{Event, Scan};
use voxelastic::mapper::Mapper;
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::{Cloud, Pose};
use voxelastic_io::store::{MapDetails, MapWriter};
use voxelastic_report::RunLog;
use voxelastic_report::content::Distances;
use voxelastic_run::{Mapping, threads};
use voxelastic_run::{map_files, usage};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

/// The world.
const WORLD: &str = "campus";
/// Scans, evenly spaced over [`PATH_M`]: as many as two cores simulate and map in less than a minute. With columns this many, they leave no holes in the ground.
const SCANS: usize = 420;
const COLUMNS: usize = 512;
/// Voxels and maximum range, metres.
const VOXEL_M: f32 = 0.1;
const MAX_RANGE_M: f32 = 30.0;
/// Length of the path, metres: once around the campus, and part of the second lap.
const PATH_M: f64 = 418.0;

/// Spacing of the points of the true surface, metres.
const TRUTH_VOXEL_M: f32 = 0.1;
/// Largest number of points measured in each map.
const MOST_POINTS: usize = 200_000;

/// Simulate a campus, map it with drift and loop closures, measure the map, and write a report
///
/// Simulates a walk of 418 m with a 64-beam LiDAR, odometry that drifts by 1 m in 100 m, and loop closures. Builds two maps, one with the corrections after
/// loop closures, with free space, too, one with odometry alone, and measures both against the exact world. The folder then contains elastic.vox, odometry.vox,
/// a picture of the map (campus.png), one of it beside that without corrections (closures.png), and report.html. Results are the same in every run.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic demo                                   writes the folder voxelastic-demo; open report.html in it
  voxelastic demo -o out --scans 60                 a scan every 7 m: sooner, with holes
  voxelastic render voxelastic-demo/elastic.vox -o campus.png --view orbit")]
pub struct DemoArgs {
    /// The folder to write
    #[arg(short, long, value_name = "DIR", default_value = "voxelastic-demo")]
    output: PathBuf,
    /// Number of scans
    #[arg(long, value_name = "N", default_value_t = SCANS, value_parser = scans)]
    scans: usize,
    /// Threads to use; 0 for all cores. Results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print the results as one JSON object on stdout
    #[arg(long)]
    json: bool,
}

fn scans(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| (20..=2000).contains(n)).ok_or_else(|| "must be a number from 20 to 2000".to_owned())
}

/// The poses that a map is built with.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Poses {
    /// Odometry with corrections after loop closures, as a SLAM system gives them.
    Elastic,
    /// Odometry alone.
    Odometry,
}

/// Runs the command.
pub fn run(args: &DemoArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    std::fs::create_dir_all(&args.output).with_context(|| format!("cannot make the folder {}", args.output.display()))?;
    interrupt::install("stopping after this scan");
    let simulation = simulation(args)?;
    let Some(clouds) = simulate_scans(&simulation, args, quiet)? else { return Ok(failure::INTERRUPTED) };
    let mut demo = Demo { args, simulation, clouds, quiet };
    let Some(log) = demo.map(Poses::Elastic)? else { return Ok(failure::INTERRUPTED) };
    if demo.map(Poses::Odometry)?.is_none() {
        return Ok(failure::INTERRUPTED);
    }
    demo.clouds = Vec::new();
    let figures = threads::pool(args.threads)?.install(|| demo.measure(&log, clock))?;
    if args.json {
        output::print_json(&figures)?;
    } else {
        output::print(&figures.table())?;
    }
    Ok(failure::DONE)
}

fn simulation(args: &DemoArgs) -> anyhow::Result<Simulation> {
    let options = SimOptions { columns: Some(COLUMNS), scans: Some(args.scans), spacing: PATH_M / (args.scans - 1) as f64, ..SimOptions::of(WORLD) };
    Ok(Simulation::new(options)?)
}

/// Simulates all scans; none if interrupted.
fn simulate_scans(simulation: &Simulation, args: &DemoArgs, quiet: bool) -> anyhow::Result<Option<Vec<Cloud>>> {
    let pool = threads::pool(args.threads)?;
    let mut progress = Progress::new("scans simulated", simulation.len() as u64, quiet);
    let mut clouds = Vec::with_capacity(simulation.len());
    let batch = 2 * pool.current_num_threads();
    while clouds.len() < simulation.len() {
        let from = clouds.len();
        let to = (from + batch).min(simulation.len());
        clouds.extend(pool.install(|| (from..to).into_par_iter().filter_map(|k| simulation.cloud(k)).collect::<Vec<_>>()));
        (from..to).for_each(|_| progress.step(String::new));
        if interrupt::requested() {
            return Ok(None);
        }
    }
    Ok(Some(clouds))
}

/// The simulation, and the scans while they are needed.
struct Demo<'a> {
    args: &'a DemoArgs,
    simulation: Simulation,
    clouds: Vec<Cloud>,
    quiet: bool,
}

impl Demo<'_> {
    fn path(&self, poses: Poses) -> PathBuf {
        self.args.output.join(if poses == Poses::Elastic { "elastic.vox" } else { "odometry.vox" })
    }

    /// Maps the scans and saves the map. Returns the log of the run; none if interrupted.
    fn map(&self, poses: Poses) -> anyhow::Result<Option<RunLog>> {
        let clock = Instant::now();
        let field = if poses == Poses::Elastic { FieldKind::Both } else { FieldKind::Tsdf };
        let settings = Settings { field, voxel_size: VOXEL_M, max_range: MAX_RANGE_M, threads: self.args.threads, ..Settings::default() };
        let mapper = Mapper::new(settings.clone()).map_err(|e| Failure::new(e.to_string(), "this is a bug"))?;
        let mut mapping = Mapping::new(mapper, threads::pool(self.args.threads)?, None);
        let mut writer = MapWriter::create(self.path(poses)).context("cannot write the map")?;
        let what = if poses == Poses::Elastic { "scans mapped" } else { "scans mapped with odometry alone" };
        let mut progress = Progress::new(what, self.simulation.len() as u64, self.quiet);
        for k in 0..self.simulation.len() {
            for event in self.events(k, poses) {
                mapping.take(event)?;
            }
            progress.step(|| format!("{} submaps", mapping.atlas().submaps().len()));
            if interrupt::requested() {
                writer.abandon();
                return Ok(None);
            }
        }
        mapping.finish();
        drop(progress);
        let details = MapDetails::describe(&settings, mapping.mapper().sensor());
        let atlas = mapping.atlas();
        mapping.pool().install(|| writer.save(atlas, &details)).context("cannot save the map")?;
        let log = RunLog { total_s: clock.elapsed().as_secs_f64(), ..mapping.log() };
        writer.write_run_log(&log.to_json()?).context("cannot save the log of the run")?;
        Ok(Some(log))
    }

    /// The events of scan `k`, in order.
    fn events(&self, k: usize, poses: Poses) -> Vec<Event> {
        let s = &self.simulation;
        let source = if poses == Poses::Elastic { PoseSource::Online } else { PoseSource::Odometry };
        let scan = Scan { node: k as u64, time: s.times()[k], t_map_lidar: s.poses(source)[k], cloud: self.clouds[k].clone() };
        let mut events = vec![Event::Scan(scan)];
        events.extend(k.checked_sub(1).map(|before| Event::OdometryEdge(s.odometry_edges()[before].clone())));
        if poses == Poses::Elastic {
            for (edge, correction) in s.loop_edges().iter().zip(s.corrections()).filter(|(edge, _)| edge.to == k as u64) {
                events.push(Event::LoopEdge(edge.clone()));
                events.push(Event::PoseUpdate((0..).zip(correction.poses.iter().copied()).collect()));
            }
        }
        events
    }

    /// Measures both maps and writes the page.
    fn measure(self, log: &RunLog, clock: Instant) -> anyhow::Result<Figures> {
        let (elastic, odometry) = (self.path(Poses::Elastic), self.path(Poses::Odometry));
        let (scans, loops) = (self.simulation.len(), self.simulation.loop_edges().len());
        let drift = largest_drift(&self.simulation);
        let limits = Limits { truth_voxel: TRUTH_VOXEL_M, reach: Limits::default().max_range, ..Limits::default() };
        let truth = Truth::of_world(self.simulation, &limits)?;
        let arguments = |map: &Path, field| EvalArgs::of(map, Path::new(WORLD)).with_field(field).with_max_points(MOST_POINTS);
        let measure = |map: &Path, field| measure_against(&arguments(map, field), &truth);
        let corrected = [measure(&elastic, Field::Tsdf)?, measure(&elastic, Field::Occupancy)?];
        let uncorrected = measure(&odometry, Field::Tsdf)?;
        let rows =
            vec![Row::of("TSDF, odometry only", &uncorrected), Row::of("TSDF, elastic", &corrected[0]), Row::of("occupancy, elastic", &corrected[1])];
        let page = self.args.output.join("report.html");
        let mut figures = Figures::new(rows, self.args.output.clone(), page);
        (figures.scans, figures.loop_closures, figures.largest_drift_m, figures.fusions) = (scans, loops, drift, log.fusions);
        figures.integrate_ms = voxelastic_eval::SeriesStats::new(&log.scans.wall_ms);
        self::page(&figures, log, &elastic, &truth, [&corrected[0], &uncorrected])?;
        render::draw_from_the_side(&elastic, &figures.picture)?;
        render::draw_beside([(&odometry, "odometry alone"), (&elastic, "with loop closures")], &figures.closures)?;
        figures.total_s = clock.elapsed().as_secs_f64();
        figures.peak_rss_mb = usage::peak_resident_bytes().map(usage::megabytes);
        Ok(figures)
    }
}

/// Largest distance between true and odometry pose, metres.
fn largest_drift(simulation: &Simulation) -> f64 {
    let apart = |(a, b): (&Pose, &Pose)| (a.translation.vector - b.translation.vector).norm();
    simulation.ground_truth().iter().zip(simulation.odometry()).map(apart).fold(0.0, f64::max)
}

/// Writes the page on the elastic map.
fn page(figures: &Figures, log: &RunLog, map: &Path, truth: &Truth, tsdf: [&Summary; 2]) -> anyhow::Result<()> {
    let loaded = map_files::load(map, LoadArgs::default().into())?;
    let details = MapDetails::describe(&loaded.settings, None);
    let surface = SurfaceArgs::default();
    let subject = Subject { atlas: &loaded.atlas, settings: &loaded.settings, details: &details, run: Some(log.clone()), surface: &surface };
    let (mut report, _) = subject.report("A walk round a campus");
    report.tables.insert(0, figures.for_page());
    for (name, summary) in ["Elastic", "Odometry only"].into_iter().zip(tsdf) {
        if let Some(found) = &summary.surface {
            let stats = found.accuracy_exact.as_ref().unwrap_or(&found.accuracy).clone();
            report.distances.push(Distances { name: format!("{name}: from the map to the world"), stats });
        }
    }
    reporting::add_errors(&mut report, truth, &Pose::identity())?;
    reporting::write(&report, &figures.report).map(|_| ())
}
