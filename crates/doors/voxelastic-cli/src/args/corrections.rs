//! Arguments for pose corrections.

use clap::Args;
use voxelastic_run::Corrections;
use voxelastic_run::corrections::Rebuild;

/// Arguments for pose corrections.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Corrections")]
pub struct CorrectionArgs {
    /// Optimise the pose graph after loop edges and correct the map: for data whose poses are odometry
    #[arg(long, hide_short_help = true)]
    optimize: bool,
    /// Find loop closures from the scans, and optimise after them; scans without poses have that by themselves
    #[arg(long, overrides_with = "no_loops")]
    loops: bool,
    /// Do not look for loop closures in scans without poses
    #[arg(long, hide_short_help = true)]
    no_loops: bool,
    /// At the end, rebuild all submaps from their scans with the final poses
    #[arg(long, conflicts_with = "rebuild_deformed", hide_short_help = true)]
    rebuild: bool,
    /// At the end, rebuild the submaps whose scans moved relative to each other by more than deform_tolerance
    #[arg(long, hide_short_help = true)]
    rebuild_deformed: bool,
}

impl CorrectionArgs {
    /// Whether scans are to be read again at the end.
    pub fn rebuilds(self) -> bool {
        self.rebuild || self.rebuild_deformed
    }

    /// What a run looks for beside mapping.
    pub fn corrections(self) -> Corrections {
        let loops = match (self.loops, self.no_loops) {
            (true, _) => Some(true),
            (_, true) => Some(false),
            _ => None,
        };
        let rebuild = match (self.rebuild, self.rebuild_deformed) {
            (true, _) => Rebuild::All,
            (_, true) => Rebuild::Deformed,
            _ => Rebuild::None,
        };
        Corrections { optimise: self.optimize, loops, rebuild }
    }
}
