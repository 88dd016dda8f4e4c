//! A copy of what a planner needs of a map, to plan in while mapping goes on.

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
        let copy = |submap: &Submap| Submap {
            scans: submap.scans.clone(),
            occupancy: submap.occupancy.clone(),
            travelled: submap.travelled,
            revision: submap.revision,
            ..Submap::new(submap.id, submap.t_map_submap)
        };
        Self { atlas: Atlas::from_submaps(atlas.submaps().iter().map(copy).collect()), voxel }
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
