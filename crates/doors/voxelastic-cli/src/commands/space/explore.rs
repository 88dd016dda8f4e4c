//! `voxelastic explore`: a robot that explores a simulated world with the map that it makes.

mod args;
mod course;
mod evenly;
mod periods;
mod picture;
mod robot;
mod truth;

pub use args::{ExploreArgs, MARGIN, radius, seconds, speed, within};

use crate::failure::{self, Failure};
use crate::meshing::SurfaceArgs;
use crate::progress::Progress;
use crate::reporting::{self, Subject};
use crate::{interrupt, output};
use course::{Course, Summary};
use robot::SimulatedRobot;
use std::path::Path;
use voxelastic_explore::{Explorer, Purpose};
use voxelastic_io::store::MapDetails;
use voxelastic_run::threads;
use voxelastic_sim::ReachableSpace;

/// Runs the command.
pub fn run(args: &ExploreArgs, quiet: bool) -> anyhow::Result<u8> {
    interrupt::install("the robot stops where it is, and what it saw so far is reported");
    let pool = threads::pool(args.threads)?;
    let (summary, was_interrupted) = pool.install(|| explore(args, quiet))?;
    tracing::info!(
        "{:.1} % of {:.0} m3 known after {:.0} m in {:.0} s; {}, {} collisions; a decision took {:.0} ms (median), at most {:.0} ms",
        100.0 * summary.known_share,
        summary.reachable_m3,
        summary.distance_m,
        summary.time_s,
        if summary.is_home { "at home" } else { "not at home" },
        summary.collisions,
        summary.decision_ms.median,
        summary.decision_ms.most
    );
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(if was_interrupted { failure::INTERRUPTED } else { failure::DONE })
}

/// Writes the page on the map and on what happened.
fn write_report(page: &Path, args: &ExploreArgs, robot: &SimulatedRobot, course: &Course) -> anyhow::Result<()> {
    let mapper = robot.mapper();
    let details = MapDetails::describe(mapper.settings(), mapper.sensor());
    let subject = Subject { atlas: mapper.atlas(), settings: mapper.settings(), details: &details, run: None, surface: &SurfaceArgs::default() };
    let (mut report, _) = subject.report(&format!("Exploration of {}, seed {}", args.world, args.seed));
    report.exploration = Some(course.replay(mapper));
    reporting::write(&report, page).map(drop)
}

/// Explores; also returns whether it was interrupted.
fn explore(args: &ExploreArgs, quiet: bool) -> anyhow::Result<(Summary, bool)> {
    let mut robot = SimulatedRobot::new(args)?;
    let settings = args.settings(robot.start(), robot.world())?;
    let truth = ReachableSpace::new(robot.world(), robot.start(), settings.bounds);
    let [low, high] = settings.bounds;
    let is_inside = (0..3).all(|k| (low[k]..=high[k]).contains(&robot.start()[k]));
    if !is_inside || truth.cells() == 0 {
        let message = format!("{}: the robot does not fit at its start {:?} into the box to explore", args.world, robot.start());
        return Err(Failure::usage(message, "use another --seed, or --bounds around the start").into());
    }
    let mut explorer = Explorer::new(settings).map_err(|error| Failure::usage(error.to_string(), "see `voxelastic explore --help`"))?;
    let mut course = Course::new(args.time);
    let mut progress = Progress::new("seconds", Some(args.time as u64), quiet);
    let mut last_second = 0;
    robot.scan()?;
    loop {
        let (t_map_lidar, cloud) = robot.last_scan();
        explorer.see(t_map_lidar, cloud);
        let decision = explorer.decide(robot.atlas(), robot.position(), Some(args.time - robot.time()))?;
        let is_done = decision.purpose == Purpose::Done || interrupt::requested() || robot.time() > 1.5 * args.time;
        course.record(&robot, &explorer, &decision, &truth, is_done);
        while last_second < robot.time() as u64 && last_second < args.time as u64 {
            last_second += 1;
            progress.step(|| format!("{:.1} % known, {:.0} m", 100.0 * course.share(), robot.distance()));
        }
        if is_done {
            break;
        }
        robot.follow(&mut explorer)?;
    }
    drop(progress);
    let was_interrupted = interrupt::requested();
    if let Some(file) = &args.picture {
        picture::draw(file, &robot, &course, explorer.settings())?;
    }
    if let Some(page) = &args.report {
        write_report(page, args, &robot, &course)?;
    }
    Ok((course.summary(args, &robot, &truth, settings.bounds), was_interrupted))
}
