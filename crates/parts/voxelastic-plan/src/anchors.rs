//! Waypoints that follow corrections of the map.

use crate::points::{Point, distance};
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::NodeId;

/// A waypoint relative to the scan taken nearest to it. It moves with the submap that holds the scan, also after that submap was merged into
/// another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// The pose-graph node of the scan.
    pub node: NodeId,
    /// The waypoint in the frame of the scan's lidar, metres.
    pub position: Point,
}

/// Anchors every point of a path (map frame) to its nearest scan; empty if the atlas holds no scan.
pub fn anchor_path(atlas: &Atlas, path: &[Point]) -> Vec<Anchor> {
    let scans: Vec<(NodeId, Pose)> = atlas.scan_poses().collect();
    let off = |pose: &Pose, p: Point| distance(pose.translation.vector.into(), p);
    let nearest = |p: &Point| scans.iter().min_by(|a, b| off(&a.1, *p).total_cmp(&off(&b.1, *p)).then(a.0.cmp(&b.0)));
    let tie = |p: &Point| nearest(p).map(|(node, pose)| Anchor { node: *node, position: pose.inverse_transform_point(&(*p).into()).coords.into() });
    path.iter().filter_map(tie).collect()
}

/// Current positions of anchored waypoints, map frame; none for a waypoint whose scan is no longer in the atlas.
pub fn resolve_anchors(atlas: &Atlas, anchors: &[Anchor]) -> Vec<Option<Point>> {
    let mut scans: Vec<(NodeId, Pose)> = atlas.scan_poses().collect();
    scans.sort_by_key(|(node, _)| *node);
    let resolve = |anchor: &Anchor| {
        let found = scans.binary_search_by_key(&anchor.node, |(node, _)| *node).ok()?;
        Some((scans[found].1 * nalgebra::Point3::from(anchor.position)).coords.into())
    };
    anchors.iter().map(resolve).collect()
}
