//! What a checkpoint has of a run beside its submaps and its journal.

use crate::log::StoredLog;
use crate::poses::{Came, Jumps, StageState};
use crate::warning::Warnings;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use voxelastic::mapper::MapperState;
use voxelastic_io::ReadPosition;
use voxelastic_slam::loops::Searches;

/// What a run knows. What grows with it is borrowed: it is serialised from where it is.
#[derive(Serialize, Deserialize)]
pub(super) struct RunState<'a> {
    /// Where the reading of the input is; none where what came does not come again.
    pub(super) position: Option<ReadPosition>,
    /// Of the odometry, if there is one.
    pub(super) stage: Option<StageState>,
    pub(super) jumps: Cow<'a, Jumps>,
    pub(super) warnings: Cow<'a, Warnings>,
    /// Scans that came, while they came.
    pub(super) came: Came,
    pub(super) log: StoredLog<'a>,
    pub(super) origin: [f64; 3],
    pub(super) searches: Option<Searches>,
    /// The edge of the voxels in which loop closures are looked for.
    pub(super) loop_voxel_m: Option<f64>,
    pub(super) mapper: MapperState<'a>,
}
