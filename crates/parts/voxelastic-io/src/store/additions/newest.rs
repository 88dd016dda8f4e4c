//! The newest state of a map of several sessions, or of laps that were kept apart.

use crate::store::MapStore;
use std::collections::BTreeMap;
use voxelastic::atlas::{Atlas, Submap, SubmapId, laps};
use voxelastic::changes::{ChangeOptions, RemovedVoxels, keep_newest};
use voxelastic::settings::{Laps, Settings};

impl MapStore {
    /// The map, which was loaded from here, without what later sessions and laps saw to be gone; and how much that is. A map of one session whose laps were not
    /// kept apart is unchanged.
    pub fn without_vanished(&self, atlas: Atlas, settings: &Settings) -> (Atlas, RemovedVoxels) {
        let ages = self.ages(&atlas, settings);
        if ages.values().max().is_none_or(|age| *age < 2) {
            return (atlas, RemovedVoxels::default());
        }
        let margin = ChangeOptions::for_voxels(settings.voxel_size).margin;
        keep_newest(atlas, |id| ages.get(&id).copied().unwrap_or_default(), margin, &settings.into())
    }

    /// Whether the map may have things that later sessions or laps saw to be gone.
    pub fn has_ages(&self, settings: &Settings) -> bool {
        settings.laps == Laps::Apart || self.manifest().all_sessions().len() > 1
    }

    /// By submap of the map, which was loaded from here, of how many sessions, or laps that were kept apart, it is the last one.
    fn ages(&self, atlas: &Atlas, settings: &Settings) -> BTreeMap<SubmapId, u32> {
        let mut sessions = self.manifest().all_sessions();
        sessions.sort_by_key(|session| session.number);
        let (mut ages, mut last) = (BTreeMap::new(), 0);
        for session in sessions {
            let own: Vec<&Submap> = atlas.submaps().iter().filter(|submap| session.has(submap.id())).collect();
            let laps = match settings.laps {
                Laps::Apart => laps(own),
                Laps::Fused => own.into_iter().map(|submap| (submap.id(), 1)).collect(),
            };
            let count = laps.values().copied().max().unwrap_or_default();
            ages.extend(laps.into_iter().map(|(id, lap)| (id, last + lap)));
            last += count;
        }
        ages
    }
}
