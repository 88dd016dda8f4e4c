//! The newest state of a map of several sessions.

use super::MapStore;
use voxelastic::atlas::Atlas;
use voxelastic::changes::{ChangeOptions, RemovedVoxels, keep_newest};
use voxelastic::settings::Settings;

impl MapStore {
    /// The map, which was loaded from here, without what later sessions saw to be gone; and how much that is. A map of one session is unchanged.
    pub fn without_vanished(&self, atlas: Atlas, settings: &Settings) -> (Atlas, RemovedVoxels) {
        let sessions = self.manifest().all_sessions();
        if sessions.len() < 2 {
            return (atlas, RemovedVoxels::default());
        }
        let age = |id| sessions.iter().find(|session| session.has(id)).map_or(0, |session| session.number);
        let margin = ChangeOptions::for_voxels(settings.voxel_size).margin;
        keep_newest(atlas, age, margin, &settings.into())
    }
}
