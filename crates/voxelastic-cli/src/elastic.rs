//! What `voxelastic map` does about corrections: loops optimised as they come, submaps rebuilt at the end.

use crate::interrupt;
use crate::mapping::Session;
use crate::progress::Progress;
use clap::Args;
use voxelastic::atlas::SubmapId;
use voxelastic::event::Event;
use voxelastic_io::source::Source;

/// How the map follows corrections.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Corrections")]
pub struct ElasticArgs {
    /// Optimise the pose graph after loop edges, and let the map follow: for data whose poses are those of odometry
    #[cfg(feature = "optimize")]
    #[arg(long)]
    optimize: bool,
    /// At the end, make all submaps anew from their scans, with the final poses
    #[arg(long, conflicts_with = "rebuild_deformed")]
    rebuild: bool,
    /// At the end, make those submaps anew that corrections have bent inside by more than deform_tolerance
    #[arg(long)]
    rebuild_deformed: bool,
}

impl ElasticArgs {
    /// What stands between the data and the mapper.
    pub fn corrector(self) -> Corrector {
        #[cfg(feature = "optimize")]
        {
            Corrector { live: self.optimize.then(|| voxelastic_optimize::LiveOptimiser::new(voxelastic_optimize::Options::default())) }
        }
        #[cfg(not(feature = "optimize"))]
        Corrector {}
    }

    /// Ends the run: fusions under way are finished, submaps rebuilt if that was asked for and nobody interrupts, and doubts settled. Returns
    /// how many were rebuilt; one that cannot be stays as it is.
    pub fn finish(self, source: &Source, session: &mut Session, quiet: bool) -> usize {
        session.finish_fusions();
        tell(session);
        let deformed = session.mapper().deformed();
        if !deformed.is_empty() {
            let most = deformed.iter().map(|d| d.distance).fold(0.0, f64::max);
            let remedy = if self.rebuild || self.rebuild_deformed { "" } else { "; --rebuild-deformed makes them anew" };
            tracing::info!("{} submaps are bent inside by corrections, by up to {most:.2} m{remedy}", deformed.len());
        }
        let submaps: Vec<SubmapId> = match (self.rebuild, self.rebuild_deformed) {
            (true, _) => session.mapper().atlas().submaps().iter().map(|s| s.id).collect(),
            (false, true) => deformed.iter().map(|d| d.submap).collect(),
            (false, false) => Vec::new(),
        };
        let mut clouds = source.clouds();
        let mut progress = Progress::new("submaps rebuilt", submaps.len() as u64, quiet);
        let mut rebuilt = 0;
        for id in submaps {
            if interrupt::requested() {
                break;
            }
            match session.rebuild(id, clouds.as_mut()) {
                Ok(_) => rebuilt += 1,
                Err(error) => tracing::warn!("left as it was: {:#}", anyhow::Error::from(error)),
            }
            progress.step(String::new);
        }
        session.finish();
        rebuilt
    }
}

/// Turns what the data says into what the mapper is told.
pub struct Corrector {
    #[cfg(feature = "optimize")]
    live: Option<voxelastic_optimize::LiveOptimiser>,
}

impl Corrector {
    /// The events that an event becomes, in order. The session's log notes what an optimisation took.
    ///
    /// # Errors
    /// When the pose graph cannot be optimised.
    #[cfg_attr(not(feature = "optimize"), allow(unused_variables))]
    pub fn take(&mut self, event: Event, session: &mut Session) -> anyhow::Result<Vec<Event>> {
        #[cfg(feature = "optimize")]
        if let Some(live) = &mut self.live {
            return Ok(timed(live, session, |live| live.handle(event))?);
        }
        Ok(vec![event])
    }

    /// The last correction, when the data ends.
    ///
    /// # Errors
    /// When the pose graph cannot be optimised.
    #[cfg_attr(not(feature = "optimize"), allow(unused_variables))]
    pub fn last(&mut self, session: &mut Session) -> anyhow::Result<Option<Event>> {
        #[cfg(feature = "optimize")]
        if let Some(live) = &mut self.live {
            return Ok(timed(live, session, voxelastic_optimize::LiveOptimiser::finish)?);
        }
        Ok(None)
    }
}

/// Does something with the optimiser, and notes the time if the graph was optimised.
#[cfg(feature = "optimize")]
fn timed<T>(
    live: &mut voxelastic_optimize::LiveOptimiser,
    session: &mut Session,
    what: impl FnOnce(&mut voxelastic_optimize::LiveOptimiser) -> T,
) -> T {
    let (runs, clock) = (live.runs(), std::time::Instant::now());
    let done = what(live);
    if live.runs() > runs {
        session.optimised(clock.elapsed());
    }
    done
}

/// The elastic part of the run in a line, if there was one.
fn tell(session: &Session) {
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
        if counts.groups_apart > 0 {
            let why = "together they would reach farther than lambda_odom + lambda_cluster";
            tracing::info!("{} groups of submaps that loops join stay apart: {why}", counts.groups_apart);
        }
    }
    if counts.unknown_poses + graph.waiting_edges > 0 {
        tracing::warn!("{} corrected poses and {} edges name nodes that never came", counts.unknown_poses, graph.waiting_edges);
    }
}
