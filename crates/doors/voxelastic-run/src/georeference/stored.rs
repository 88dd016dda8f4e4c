//! Where a saved map lies on Earth.

use super::nodes::Nodes;
use crate::error::Result;
use crate::map_files::place_of;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_earth::Geodetic;
use voxelastic_io::store::MapStore;

/// The trajectory of a map on Earth, by time, or by node where nobody knows times; none of a map that is nowhere.
///
/// # Errors
/// A damaged map.
pub fn trajectory(store: &MapStore) -> Result<Option<Vec<(f64, Geodetic)>>> {
    let Some(place) = place_of(store)? else { return Ok(None) };
    let nodes = Nodes::of(store)?;
    let at = |(node, pose): &(NodeId, Pose)| {
        let time = nodes.times.get(node).copied().unwrap_or(*node as f64);
        Some((time, place.to_earth(pose.translation.vector.into())?))
    };
    Ok(nodes.poses.iter().map(at).collect())
}
