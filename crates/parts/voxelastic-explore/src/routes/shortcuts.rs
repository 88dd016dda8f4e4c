//! The way home along the robot's own track, with shortcuts where the map has them free: in a large map no search of the whole of it is needed.

use crate::routes::track_graph::track_way;
use voxelastic_plan::{Point, Space};

/// A way along a track with shortcuts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ShortWay {
    /// From the first place to the last.
    pub path: Vec<Point>,
    /// The ends of each shortcut, in order: straight motions that the map has free. Between them the way is the track.
    pub shortcuts: Vec<[Point; 2]>,
}

/// The shortest way along the track from the robot, which came along it, back to its first place, cut short by the longest straight motions that doubling steps find.
pub(crate) fn short_way<S: Space>(space: &S, track: &[Point], robot: Point) -> ShortWay {
    let way = track_way(space, track, robot);
    let places = &way.places;
    let mut short = ShortWay { path: vec![robot], shortcuts: Vec::new() };
    let (mut at, last) = (0, places.len() - 1);
    while at < last {
        let next = straight_on(space, places, at);
        if next > at + 1 || way.is_crossing[at] {
            short.shortcuts.push([places[at], places[next]]);
        }
        short.path.push(places[next]);
        at = next;
    }
    short
}

/// The farthest place along the track to which steps lead that double where the map has the straight motion free, and halve where not; the next one if there is none.
fn straight_on<S: Space>(space: &S, track: &[Point], at: usize) -> usize {
    let (mut next, mut step) = (at + 1, 1);
    while step > 0 && next + 1 < track.len() {
        let to = (next + step).min(track.len() - 1);
        if space.connects(track[at], track[to]) {
            (next, step) = (to, 2 * step);
        } else {
            step /= 2;
        }
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::routes::track_graph::tests::{Plane, along};
    use proptest::prelude::*;
    use voxelastic_plan::{distance, length};

    #[test]
    fn a_detour_is_cut_off_and_a_wall_is_not() {
        let way = |ends: &[[f64; 2]]| {
            let (track, robot) = along(ends);
            short_way(&Plane, &track, robot)
        };
        // Along a curve without a wall between: straight home.
        let straight = [[0.0, 3.0, 0.0], [60.0, 3.0, 0.0]];
        assert_eq!(way(&[[60.0, 3.0], [20.0, 30.0], [0.0, 3.0]]), ShortWay { path: straight.to_vec(), shortcuts: vec![straight] });
        // A loop of 100 m that comes by 10 m from where it began, out of sight of what is between.
        let by = way(&[[0.0, 8.0], [0.0, 2.0], [0.0, 40.0], [10.0, 40.0], [10.0, 0.0], [0.0, 0.0], [0.0, -40.0]]);
        assert!(length(&by.path) < 40.0 + 10.0 + 13.0, "{by:?}");
        // Through the gap it came, and so it goes.
        let through = way(&[[0.0, -3.0], [10.0, -3.0], [10.0, 3.0], [0.0, 3.0]]);
        assert!(length(&through.path) > 2.0 * 9.0 && length(&through.path) < 26.0, "{through:?}");
        let nowhere = ShortWay { path: vec![[0.0; 3]], shortcuts: vec![] };
        assert_eq!([&[][..], &[[0.0; 3]]].map(|track| short_way(&Plane, track, [0.0; 3])), [nowhere.clone(), nowhere]);
    }

    proptest! {
        #[test]
        fn shortcuts_are_free_in_order_and_never_longer(ends in prop::collection::vec(prop::array::uniform2(-30.0f64..30.0), 2..8)) {
            let (track, robot) = along(&ends);
            let way = short_way(&Plane, &track, robot);
            let mut shortcuts = way.shortcuts.iter();
            let mut next = shortcuts.next();
            for ends in way.path.windows(2) {
                if next.is_some_and(|[from, to]| *from == ends[0] && *to == ends[1]) {
                    prop_assert!(Plane.connects(ends[0], ends[1]));
                    next = shortcuts.next();
                } else {
                    prop_assert!(distance(ends[0], ends[1]) < 2.0, "a step along the track");
                }
            }
            prop_assert!(next.is_none() && way.path[0] == robot && way.path.last() == track.first());
            prop_assert!(length(&way.path) <= length(&track_way(&Plane, &track, robot).places) + 1e-6);
        }
    }
}
