//! What a checkpoint has of a run beside its submaps and its journal.

use crate::input::InputState;
use crate::jumps::Jumps;
use crate::recorder::StoredLog;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use voxelastic::mapper::MapperState;
use voxelastic_slam::loops::Searches;

/// What a run knows. What grows with it is borrowed: it is serialised from where it is.
#[derive(Serialize, Deserialize)]
pub(super) struct RunState<'a> {
    pub(super) input: InputState,
    pub(super) jumps: Cow<'a, Jumps>,
    pub(super) skipped: usize,
    /// Scans that came, and those that were left out, while they came.
    pub(super) came: [usize; 2],
    pub(super) log: StoredLog<'a>,
    pub(super) origin: [f64; 3],
    pub(super) searches: Option<Searches>,
    /// The edge of the voxels in which loop closures are looked for.
    pub(super) loop_voxel_m: Option<f64>,
    pub(super) mapper: MapperState<'a>,
}
