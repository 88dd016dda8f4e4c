//! Paths in a map that bends: which parts still hold, and where waypoints went.

use crate::points::{Point, between, distance};
use crate::space::Space;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::NodeId;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;

/// A part of a path that the robot can no longer take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Broken {
    /// The piece of the path: from point `piece` to the next.
    pub piece: usize,
    /// How far along the piece the robot still gets, metres.
    pub free: f64,
    /// Where that is.
    pub at: Point,
    /// What the map says of that place: [`State::Free`] where only the robot's rim is in the way.
    pub state: State,
}

/// The pieces of `path` that the robot of `space` cannot take in the map as it is now, in their order; none when all of it holds.
///
/// ```
/// use voxelastic::{atlas::Atlas, query::AtlasQuery};
/// use voxelastic_plan::{Air, Robot, recheck};
/// let atlas = Atlas::default();
/// let map = AtlasQuery::new(&atlas, 0.065);
/// let air = Air::new(&map, &Robot::flying(0.3), [[-9.0; 3], [9.0; 3]]);
/// assert_eq!(recheck(&air, &map, &[[0.0; 3], [1.0; 3]]).len(), 1, "nothing is known of an empty map");
/// ```
pub fn recheck<S: Space>(space: &S, map: &AtlasQuery<'_>, path: &[Point]) -> Vec<Broken> {
    let broken = |(piece, ends): (usize, &[Point])| {
        let [from, to] = [ends[0], ends[1]];
        if space.holds(from, to) {
            return None;
        }
        let all = distance(from, to);
        let (mut free, mut blocked) = (0.0, 1.0);
        while (blocked - free) * all > 0.5 * map.voxel() {
            let middle = 0.5 * (free + blocked);
            *(if space.holds(from, between(from, to, middle)) { &mut free } else { &mut blocked }) = middle;
        }
        let at = between(from, to, free);
        Some(Broken { piece, free: free * all, at, state: map.state(at) })
    };
    path.windows(2).enumerate().filter_map(broken).collect()
}

/// A waypoint tied to the scan that was taken nearest to it: it moves with the submap that holds the scan, also when that is fused into
/// another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// The pose-graph node of the scan.
    pub node: NodeId,
    /// The waypoint in the frame of the scan's lidar, metres.
    pub place: Point,
}

/// Where the scans of an atlas are now: node and pose of the lidar in the map frame.
fn scans(atlas: &Atlas) -> impl Iterator<Item = (NodeId, Pose)> + '_ {
    let retiring = atlas.retiring().map(|retiring| (retiring.submap, retiring.t_map_submap));
    let all = atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap)).chain(retiring);
    all.flat_map(|(submap, t_map_submap)| submap.scans.iter().map(move |scan| (scan.node, t_map_submap * scan.t_submap_lidar)))
}

/// Ties every point of a path (map frame) to the atlas; none of them where the atlas holds no scan.
pub fn anchor(atlas: &Atlas, path: &[Point]) -> Vec<Anchor> {
    let scans: Vec<(NodeId, Pose)> = scans(atlas).collect();
    let off = |pose: &Pose, p: Point| distance(pose.translation.vector.into(), p);
    let nearest = |p: &Point| scans.iter().min_by(|a, b| off(&a.1, *p).total_cmp(&off(&b.1, *p)).then(a.0.cmp(&b.0)));
    let tie = |p: &Point| nearest(p).map(|(node, pose)| Anchor { node: *node, place: pose.inverse_transform_point(&(*p).into()).coords.into() });
    path.iter().filter_map(tie).collect()
}

/// Where anchored waypoints are now, map frame; none for one whose scan is in the atlas no longer.
pub fn place(atlas: &Atlas, anchors: &[Anchor]) -> Vec<Option<Point>> {
    let mut scans: Vec<(NodeId, Pose)> = scans(atlas).collect();
    scans.sort_by_key(|(node, _)| *node);
    let now = |anchor: &Anchor| {
        let found = scans.binary_search_by_key(&anchor.node, |(node, _)| *node).ok()?;
        Some((scans[found].1 * nalgebra::Point3::from(anchor.place)).coords.into())
    };
    anchors.iter().map(now).collect()
}
