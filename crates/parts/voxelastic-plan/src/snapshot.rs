//! A copy of the occupancy of a map, for planning while mapping continues.

use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::tsdf::TsdfField;
use voxelastic::query::AtlasQuery;

/// Occupancy and poses of all submaps at one moment. It is independent of the atlas it was copied from and can be sent to another thread.
///
/// Costs one copy of the occupancy in memory.
#[derive(Clone, Debug)]
pub struct Snapshot {
    atlas: Atlas,
}

impl Snapshot {
    /// The current state of `atlas`.
    pub fn of(atlas: &Atlas) -> Self {
        let copy = |(submap, t_map_submap): (&Submap, Pose)| {
            let copy = Submap::new(submap.id(), submap.voxel_size(), t_map_submap);
            copy.with_fields(TsdfField::default(), submap.occupancy().clone()).with_scans(submap.scans().to_vec(), submap.travelled())
        };
        // A submap that is being merged still holds observations that its target lacks.
        Self { atlas: Atlas::from_submaps(atlas.voxel_size(), atlas.placed().map(copy).collect()) }
    }

    /// Queries of the snapshot.
    pub fn query(&self) -> AtlasQuery<'_> {
        AtlasQuery::new(&self.atlas)
    }

    /// Its submaps, without surfaces; waypoints can be [anchored](crate::anchor_path) to them.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }
}
