//! Pose corrections in `voxelastic map`: optimisation after loop edges, rebuilding of submaps at the end.

use crate::failure::one_line;
use crate::input::Input;
use crate::interrupt;
use crate::mapping::Session;
use crate::progress::Progress;
use clap::Args;
use voxelastic::atlas::SubmapId;
use voxelastic::event::Event;
use voxelastic_io::PoseKind;
use voxelastic_slam::graph::{LiveOptimiser, Options};

/// Arguments for pose corrections.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Corrections")]
pub struct ElasticArgs {
    /// Optimise the pose graph after loop edges and correct the map: for data whose poses are odometry
    #[arg(long)]
    optimize: bool,
    /// At the end, rebuild all submaps from their scans with the final poses
    #[arg(long, conflicts_with = "rebuild_deformed")]
    rebuild: bool,
    /// At the end, rebuild the submaps whose scans moved relative to each other by more than deform_tolerance
    #[arg(long)]
    rebuild_deformed: bool,
}

impl ElasticArgs {
    /// The poses to start from where the data have both: the optimiser needs odometry.
    pub fn pose_kind(self) -> PoseKind {
        if self.optimize { PoseKind::Odometry } else { PoseKind::Optimised }
    }

    /// The stage between the source and the mapper.
    pub fn corrector(self) -> Corrector {
        Corrector { optimiser: self.optimize.then(|| LiveOptimiser::new(Options::default())) }
    }

    /// Ends the run: completes fusions, rebuilds submaps if requested and not interrupted, and resolves conflicts between submaps. Returns
    /// the number of rebuilt submaps; a submap that cannot be rebuilt is left unchanged.
    pub fn finish(self, input: &Input, session: &mut Session, quiet: bool) -> usize {
        session.finish_fusions();
        log_summary(session);
        let deformed = session.mapper().deformed();
        if !deformed.is_empty() {
            let most = deformed.iter().map(|d| d.distance).fold(0.0, f64::max);
            let remedy = if self.rebuild || self.rebuild_deformed { "" } else { "; --rebuild-deformed rebuilds them" };
            tracing::info!("corrections moved scans of {} submaps relative to each other, by up to {most:.2} m{remedy}", deformed.len());
        }
        let submaps: Vec<SubmapId> = match (self.rebuild, self.rebuild_deformed) {
            (true, _) => session.mapper().atlas().submaps().iter().map(|s| s.id()).collect(),
            (false, true) => deformed.iter().map(|d| d.submap).collect(),
            (false, false) => Vec::new(),
        };
        let mut clouds = input.clouds();
        let mut progress = Progress::new("submaps rebuilt", submaps.len() as u64, quiet);
        let mut rebuilt = 0;
        for id in submaps {
            if interrupt::requested() {
                break;
            }
            match session.rebuild(id, clouds.as_mut()) {
                Ok(_) => rebuilt += 1,
                Err(error) => tracing::warn!("submap {id} is not rebuilt: {}", one_line(&error.into())),
            }
            progress.step(String::new);
        }
        session.finish();
        rebuilt
    }
}

/// Inserts pose updates into the events of the source, by the pose-graph optimiser if it is enabled.
pub struct Corrector {
    optimiser: Option<LiveOptimiser>,
}

impl Corrector {
    /// Returns the events for the mapper, in order. The time of an optimisation goes into the log of the session.
    ///
    /// # Errors
    /// When the pose graph cannot be optimised.
    pub fn take(&mut self, event: Event, session: &mut Session) -> anyhow::Result<Vec<Event>> {
        if let Some(optimiser) = &mut self.optimiser {
            return Ok(timed(optimiser, session, |o| o.handle(event))?);
        }
        Ok(vec![event])
    }

    /// The last correction, after the last event.
    ///
    /// # Errors
    /// When the pose graph cannot be optimised.
    pub fn last(&mut self, session: &mut Session) -> anyhow::Result<Option<Event>> {
        if let Some(optimiser) = &mut self.optimiser {
            return Ok(timed(optimiser, session, LiveOptimiser::finish)?);
        }
        Ok(None)
    }
}

/// Runs a step of the optimiser, and logs its time if the graph was optimised in it.
fn timed<T>(optimiser: &mut LiveOptimiser, session: &mut Session, step: impl FnOnce(&mut LiveOptimiser) -> T) -> T {
    let (runs, clock) = (optimiser.runs(), std::time::Instant::now());
    let result = step(optimiser);
    if optimiser.runs() > runs {
        session.optimised(clock.elapsed());
    }
    result
}

/// Logs counts of loop edges, corrections and fusions, if there were any.
fn log_summary(session: &Session) {
    let (counts, graph) = (session.mapper().elastic_counts(), session.mapper().graph_counts());
    if graph.loop_edges > 0 || counts.pose_updates > 0 {
        tracing::info!(
            "{} loop edges ({} not confirmed by the poses), {} pose updates, {} submaps moved, {} fusions",
            graph.loop_edges,
            graph.open_loops,
            counts.pose_updates,
            counts.submap_moves,
            counts.fusions
        );
        if counts.size_limited_groups > 0 {
            let why = "the merged submap would be larger than lambda_odom + lambda_cluster";
            tracing::info!("{} groups of submaps joined by loop edges are not merged: {why}", counts.size_limited_groups);
        }
    }
    if counts.unknown_poses + graph.waiting_edges > 0 {
        tracing::warn!("{} corrected poses and {} edges refer to nodes without a scan", counts.unknown_poses, graph.waiting_edges);
    }
}
