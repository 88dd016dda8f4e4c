//! Pose corrections in `voxelastic map`: optimisation after loop edges, rebuilding of submaps at the end.

use crate::failure::one_line;
use crate::interrupt;
use crate::mapping::Session;
use crate::progress::Progress;
use clap::Args;
use voxelastic::atlas::SubmapId;
use voxelastic::mapper::ScanSource;
use voxelastic_io::PoseKind;
use voxelastic_slam::Corrector;
use voxelastic_slam::graph::{LiveOptimiser, Options};
use voxelastic_slam::loops::{LoopFinder, LoopSettings, Searches};

/// Arguments for pose corrections.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Corrections")]
pub struct ElasticArgs {
    /// Optimise the pose graph after loop edges and correct the map: for data whose poses are odometry
    #[arg(long)]
    optimize: bool,
    /// Find loop closures from the scans, and optimise after them; scans without poses have that by themselves
    #[arg(long, overrides_with = "no_loops")]
    loops: bool,
    /// Do not look for loop closures in scans without poses
    #[arg(long)]
    no_loops: bool,
    /// At the end, rebuild all submaps from their scans with the final poses
    #[arg(long, conflicts_with = "rebuild_deformed")]
    rebuild: bool,
    /// At the end, rebuild the submaps whose scans moved relative to each other by more than deform_tolerance
    #[arg(long)]
    rebuild_deformed: bool,
}

impl ElasticArgs {
    /// Whether scans are to be read again at the end.
    pub fn rebuilds(self) -> bool {
        self.rebuild || self.rebuild_deformed
    }

    /// The poses to start from where the data have both: the optimiser needs odometry.
    pub fn pose_kind(self) -> PoseKind {
        if self.optimize || self.loops { PoseKind::Odometry } else { PoseKind::Optimised }
    }

    /// What decides about the map before its end, in words.
    pub fn identity(self) -> String {
        format!("optimize {}, loops {}, no loops {}", self.optimize, self.loops, self.no_loops)
    }

    /// The stage between the source and the mapper; `is_raw` if the poses are estimated. `known` are the outcomes of its first searches for
    /// loop closures, if an earlier process has searched.
    pub fn corrector(self, is_raw: bool, known: Option<Searches>) -> Corrector {
        self.corrector_with(is_raw, known, LoopSettings::default())
    }

    /// As [`corrector`](Self::corrector), with settings of the search for loop closures.
    pub fn corrector_with(self, is_raw: bool, known: Option<Searches>, loops: LoopSettings) -> Corrector {
        let finds_loops = self.loops || is_raw && !self.no_loops;
        let optimiser = (self.optimize || finds_loops).then(|| LiveOptimiser::new(Options::default()));
        let mut corrector = Corrector::default();
        if let Some(optimiser) = optimiser {
            corrector = corrector.with_optimiser(if is_raw { optimiser.with_pieces() } else { optimiser });
        }
        if finds_loops { corrector.with_finder(LoopFinder::new(loops).with_searches(known.unwrap_or_default())) } else { corrector }
    }

    /// Ends the run: completes fusions, rebuilds submaps if requested and not interrupted, and resolves conflicts between submaps. Returns
    /// the number of rebuilt submaps; a submap that cannot be rebuilt is left unchanged.
    pub fn finish(self, mut clouds: Box<dyn ScanSource + Send>, session: &mut Session, quiet: bool) -> usize {
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

/// Does a step of the corrector in the session's threads. The time of an optimisation goes into the log of the session.
pub fn corrected<T: Send>(corrector: &mut Corrector, session: &mut Session, step: impl FnOnce(&mut Corrector) -> T + Send) -> T {
    let result = session.pool().install(|| step(corrector));
    if let Some(took) = corrector.take_optimisation_time() {
        session.optimised(took);
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
