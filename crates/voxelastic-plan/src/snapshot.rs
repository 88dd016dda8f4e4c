//! A copy of what a planner needs of a map, to plan in while mapping goes on.

use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::query::AtlasQuery;

/// Occupancy and poses of all submaps at one moment. It can be sent to another thread; the atlas it was taken from goes on.
///
/// Taking one copies the occupancy's arrays as they are in memory.
#[derive(Clone, Debug)]
pub struct Snapshot {
    atlas: Atlas,
    voxel: f32,
}

impl Snapshot {
    /// The state of `atlas`, whose finest voxels have edges of `voxel` metres.
    pub fn of(atlas: &Atlas, voxel: f32) -> Self {
        let copy = |(submap, t_map_submap): (&Submap, Pose)| Submap {
            scans: submap.scans.clone(),
            occupancy: submap.occupancy.clone(),
            travelled: submap.travelled,
            revision: submap.revision,
            ..Submap::new(submap.id, t_map_submap)
        };
        // A submap on its way into another is still the only one that knows what it knows.
        let retiring = atlas.retiring().map(|retiring| (retiring.submap, retiring.t_map_submap));
        let all = atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap)).chain(retiring);
        Self { atlas: Atlas::from_submaps(all.map(copy).collect()), voxel }
    }

    /// What can be asked of it.
    pub fn query(&self) -> AtlasQuery<'_> {
        AtlasQuery::new(&self.atlas, self.voxel)
    }

    /// Its submaps, without surfaces: what waypoints are [anchored](crate::anchor) to.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }
}
