//! How a run begins: anew, or where an earlier process was.

use super::{Alignment, Kept, MappingRun};
use crate::Result;
use crate::corrections::Corrections;
use crate::keep::{CheckpointEvery, Comes, Identity, Keeper, Target, Unfinished};
use crate::mapping::{Mapping, empty_mapper};
use crate::poses::{Jumps, PoseStage, Poses, Relocalisation, StreamPosition};
use crate::warning::Warnings;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;
use voxelastic::settings::Settings;
use voxelastic_slam::Corrector;
use voxelastic_slam::loops::LoopSettings;

/// What a run is to do.
pub struct Plan {
    /// Of the mapper.
    pub settings: Settings,
    /// What is looked for beside mapping.
    pub corrections: Corrections,
    /// Where poses come from.
    pub poses: Poses,
    /// The sensor's own tables of beams, if they are known.
    pub sensor: Option<BeamModel>,
    /// Whether what comes can be had again.
    pub comes: Comes,
}

impl MappingRun {
    /// A run with an empty map.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(plan: Plan, pool: rayon::ThreadPool) -> Result<Self> {
        let Plan { settings, corrections, poses, sensor, comes } = plan;
        let mapping = Mapping::new(empty_mapper(&settings, sensor.clone())?, pool, None);
        let mut run = Self {
            mapping,
            poses: PoseStage::new(poses, None),
            corrections,
            corrector: Corrector::default(),
            is_decided: false,
            jumps: Jumps::default(),
            position: StreamPosition::new(comes == Comes::Again),
            alignment: Alignment::default(),
            sensor,
            pose_watch: None,
            following: None,
            kept: None,
            resumed: 0,
            warnings: Warnings::default(),
        };
        run.decide();
        Ok(run)
    }

    /// A run that goes on where an earlier process was. What comes must follow that, unless it comes only once. `clouds` reads again what came before.
    ///
    /// # Errors
    /// When that cannot be read, or settings are out of range.
    pub fn resumed(plan: Plan, pool: rayon::ThreadPool, mut unfinished: Unfinished, clouds: &mut (dyn ScanSource + Send)) -> Result<Self> {
        let Plan { settings, corrections, poses, sensor, comes } = plan;
        let mut poses = match poses {
            Poses::Undecided(stage) if unfinished.stage.is_some() => Poses::Estimated(Box::new(stage()?)),
            Poses::Undecided(_) => Poses::Given,
            decided => decided,
        };
        if let (Poses::Estimated(stage), Some(state)) = (&mut poses, unfinished.stage.take()) {
            // Those who carry a sensor on do not wait.
            if comes == Comes::Once { stage.resume_log(state) } else { stage.resume(state) }
        }
        let is_raw = matches!(poses, Poses::Estimated(_));
        let mut loops = LoopSettings::default();
        if comes == Comes::Once {
            unfinished = unfinished.for_other_scans();
        }
        if comes != Comes::Again {
            // What is kept of the scans does not tell it.
            loops.voxel_size = unfinished.loop_voxel_m;
        }
        let mut corrector = corrections.corrector(is_raw, unfinished.searches.clone(), loops);
        let (resumed, came, origin) = (unfinished.scans(), unfinished.came, unfinished.origin);
        let (jumps, warnings) = (unfinished.jumps.clone(), std::mem::take(&mut unfinished.warnings));
        let (last_node, next_node) = unfinished.nodes();
        let mapping = unfinished.mapping(&settings, sensor.clone(), clouds, &mut corrector, pool)?;
        let mut poses = PoseStage::new(poses, Some(origin));
        let mut alignment = Alignment::default();
        if comes == Comes::Once {
            poses.go_on(next_node, Some(origin));
            alignment = Alignment { search: Some(Box::new(Relocalisation::new(&mapping, !is_raw))), last_node, t_map_frame: None };
        }
        let position = StreamPosition::new(comes == Comes::Again).after(came);
        Ok(Self {
            mapping,
            poses,
            corrections,
            corrector,
            is_decided: true,
            jumps,
            position,
            alignment,
            sensor,
            pose_watch: None,
            following: None,
            kept: None,
            resumed,
            warnings,
        })
    }

    /// Keeps the run in `target`: checkpoints now and then, and its map at the end. `identity` says what decides about the bits of the map. `sensors` are those whose
    /// first clouds are kept already.
    #[must_use]
    pub fn kept_in(mut self, target: Target, identity: Identity, every: CheckpointEvery, comes: Comes, sensors: &[u16]) -> Self {
        self.kept = Some(Kept { target, identity, every, comes, keeper: None });
        self.begin_to_keep();
        if let Some(keeper) = self.keeper() {
            keeper.know_sensors(sensors.iter().copied());
        }
        self
    }

    /// Decides what corrects poses, once it is known where they come from.
    pub(super) fn decide(&mut self) {
        if !self.is_decided
            && let Some(is_raw) = self.poses.is_raw()
        {
            self.is_decided = true;
            self.corrector = self.corrections.corrector(is_raw, None, LoopSettings::default());
            self.begin_to_keep();
        }
    }

    fn begin_to_keep(&mut self) {
        let (scans, is_raw) = (self.scans(), self.poses.is_raw() == Some(true));
        if let Some(Kept { identity, every, comes, keeper: keeper @ None, .. }) = self.kept.as_mut().filter(|_| self.is_decided) {
            *keeper = Some(Keeper::new(*every, identity.clone(), *comes, &self.corrector, is_raw, scans));
        }
    }
}
