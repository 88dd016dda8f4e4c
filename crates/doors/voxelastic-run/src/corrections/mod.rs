//! Pose corrections: loop closures, optimisation after them, and the rebuilding of submaps at the end.

mod closure_summary;

pub use closure_summary::{ClosureSummary, TriedClosure};

use voxelastic_io::PoseKind;
use voxelastic_slam::Corrector;
use voxelastic_slam::graph::{LiveOptimiser, Options};
use voxelastic_slam::loops::{LoopFinder, LoopSettings, Searches};

/// What is looked for beside mapping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Corrections {
    /// Whether the pose graph is optimised after loop edges, also after those that are given.
    pub optimise: bool,
    /// Whether loop closures are found from the scans; none: only in scans without poses.
    pub loops: Option<bool>,
    /// Which submaps are rebuilt from their scans at the end.
    pub rebuild: Rebuild,
}

/// Which submaps are rebuilt from their scans at the end of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rebuild {
    /// None.
    #[default]
    None,
    /// Those whose scans corrections have moved relative to each other.
    Deformed,
    /// All.
    All,
}

impl Corrections {
    /// The poses to start from where the data have both: the optimiser needs odometry.
    pub fn pose_kind(self) -> PoseKind {
        if self.optimise || self.loops == Some(true) { PoseKind::Odometry } else { PoseKind::Optimised }
    }

    /// What decides about the map before its end, in words.
    pub fn identity(self) -> String {
        format!("optimise {}, loops {:?}", self.optimise, self.loops)
    }

    /// The stage between the poses and the mapper; `is_raw` if the poses are estimated. `known` are the outcomes of its first searches for
    /// loop closures, if an earlier process has searched.
    pub fn corrector(self, is_raw: bool, known: Option<Searches>, settings: LoopSettings) -> Corrector {
        let finds_loops = self.loops.unwrap_or(is_raw);
        let mut corrector = Corrector::default();
        if self.optimise || finds_loops {
            let optimiser = LiveOptimiser::new(Options::default());
            corrector = corrector.with_optimiser(if is_raw { optimiser.with_pieces() } else { optimiser });
        }
        if finds_loops { corrector.with_finder(LoopFinder::new(settings).with_searches(known.unwrap_or_default())) } else { corrector }
    }
}
