//! Checks of an existing path against the map as it is now.

use crate::points::{Point, between, distance};
use crate::space::Space;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;

/// A segment of a path that is no longer free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockedSegment {
    /// Index of the segment: from point `segment` of the path to the next.
    pub segment: usize,
    /// How far along the segment the robot still gets, metres.
    pub free: f64,
    /// The position there, map frame, metres.
    pub at: Point,
    /// The map's state at that position: [`State::Free`] where only the robot's rim touches something.
    pub state: State,
}

/// The segments of `path` that are not free in the current map, in order; empty when the whole path is free.
///
/// ```
/// use voxelastic::atlas::Atlas;
/// use voxelastic_plan::{FlyingSpace, Robot, recheck};
/// let atlas = Atlas::new(0.065);
/// let map = atlas.query().unwrap();
/// let space = FlyingSpace::new(&map, &Robot::flying(0.3), [[-9.0; 3], [9.0; 3]]);
/// assert_eq!(recheck(&space, &map, &[[0.0; 3], [1.0; 3]]).len(), 1, "an empty map is unknown everywhere");
/// ```
pub fn recheck<S: Space>(space: &S, map: &AtlasQuery<'_>, path: &[Point]) -> Vec<BlockedSegment> {
    let check = |(segment, ends): (usize, &[Point])| {
        let [from, to] = [ends[0], ends[1]];
        if space.is_segment_free(from, to) {
            return None;
        }
        let length = distance(from, to);
        let (mut free, mut blocked) = (0.0, 1.0);
        while (blocked - free) * length > 0.5 * map.voxel_size() {
            let middle = 0.5 * (free + blocked);
            *(if space.is_segment_free(from, between(from, to, middle)) { &mut free } else { &mut blocked }) = middle;
        }
        let at = between(from, to, free);
        Some(BlockedSegment { segment, free: free * length, at, state: map.state(at) })
    };
    path.windows(2).enumerate().filter_map(check).collect()
}
