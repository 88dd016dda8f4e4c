//! The way home along the robot's own track, with shortcuts where the map has them free: in a large map no search of the whole of it is needed.

use voxelastic_plan::{Point, Space, distance};

/// Shortcuts to where the track comes back near itself are at most this long, metres.
const LONGEST: f64 = 15.0;
/// Places of the track that are tried for one, at most.
const TRIED: usize = 6;
/// They are at least this far apart along the track, in places of it.
const APART: usize = 4;

/// A way along a track with shortcuts.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ShortWay {
    /// From the first place to the last.
    pub path: Vec<Point>,
    /// The ends of each shortcut, in order: straight motions that the map has free. Between them the way is the track.
    pub shortcuts: Vec<[Point; 2]>,
}

/// The track, with shortcuts from one place of it to a later one: to the last that is near, or to the farthest along it that doubling steps find.
pub(crate) fn short_way<S: Space>(space: &S, track: &[Point]) -> ShortWay {
    let mut way = ShortWay { path: track.iter().take(1).copied().collect(), shortcuts: Vec::new() };
    let (mut at, last) = (0, track.len().saturating_sub(1));
    while at < last {
        let next = near_itself(space, track, at).max(straight_on(space, track, at));
        if next > at + 1 {
            way.shortcuts.push([track[at], track[next]]);
        }
        way.path.push(track[next]);
        at = next;
    }
    way
}

/// The last place of the track near the one at `at` to which the map has a straight motion free; the next one if there is none.
fn near_itself<S: Space>(space: &S, track: &[Point], at: usize) -> usize {
    let mut before = usize::MAX;
    let is_near = |k: &usize| distance(track[at], track[*k]) < LONGEST;
    let is_apart = |k: &usize| {
        *k + APART <= before && {
            before = *k;
            true
        }
    };
    let tried = (at + 2..track.len()).rev().filter(is_near).filter(is_apart).take(TRIED);
    tried.into_iter().find(|k| space.connects(track[at], track[*k])).unwrap_or(at + 1)
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
    use proptest::prelude::*;
    use voxelastic_plan::length;

    /// A plane with a wall along y = 0.5 that has a gap between x = 9 and 11.
    struct Plane;

    impl Space for Plane {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            let share = (0.5 - from[1]) / (to[1] - from[1]);
            let x = from[0] + share * (to[0] - from[0]);
            (!(0.0..=1.0).contains(&share) || (9.0..11.0).contains(&x)).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            Some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-1e3; 3], [1e3; 3]]
        }
    }

    /// The places from each of `ends` to the next, half a metre apart.
    fn along(ends: &[[f64; 2]]) -> Vec<Point> {
        let mut places = vec![[ends[0][0], ends[0][1], 0.0]];
        for pair in ends.windows(2) {
            let n = ((pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]) / 0.5).ceil().max(1.0);
            places.extend((1..=n as usize).map(|k| {
                let share = k as f64 / n;
                [pair[0][0] + share * (pair[1][0] - pair[0][0]), pair[0][1] + share * (pair[1][1] - pair[0][1]), 0.0]
            }));
        }
        places
    }

    #[test]
    fn a_detour_is_cut_off_and_a_wall_is_not() {
        // Along a curve without a wall between: straight home.
        let curve = short_way(&Plane, &along(&[[0.0, 3.0], [20.0, 30.0], [60.0, 3.0]]));
        let straight = [[0.0, 3.0, 0.0], [60.0, 3.0, 0.0]];
        assert_eq!(curve, ShortWay { path: straight.to_vec(), shortcuts: vec![straight] });
        // A loop of 100 m that comes by 10 m from where it began, out of sight of what is between.
        let by = short_way(&Plane, &along(&[[0.0, -40.0], [0.0, 0.0], [10.0, 0.0], [10.0, 40.0], [0.0, 40.0], [0.0, 2.0], [0.0, 8.0]]));
        assert!(length(&by.path) < 40.0 + 10.0 + 13.0, "{by:?}");
        // Through the gap it came, and so it goes.
        let through = along(&[[0.0, 3.0], [10.0, 3.0], [10.0, -3.0], [0.0, -3.0]]);
        let way = short_way(&Plane, &through);
        assert!(length(&way.path) > 2.0 * 9.0 && length(&way.path) < length(&through), "{way:?}");
        let nowhere = |path: &[Point]| ShortWay { path: path.to_vec(), shortcuts: vec![] };
        assert_eq!([&through[..1], &[]].map(|track| short_way(&Plane, track)), [nowhere(&through[..1]), nowhere(&[])]);
    }

    proptest! {
        #[test]
        fn shortcuts_are_free_in_order_and_never_longer(ends in prop::collection::vec(prop::array::uniform2(-30.0f64..30.0), 2..8)) {
            let track = along(&ends);
            let way = short_way(&Plane, &track);
            let mut at = 0;
            let mut along_them = 0.0;
            for [from, to] in &way.shortcuts {
                prop_assert!(Plane.connects(*from, *to));
                let [start, end] = [from, to].map(|end| at + track[at..].iter().position(|p| p == end).unwrap());
                along_them += length(&track[at..=start]) + distance(*from, *to);
                at = end;
            }
            along_them += length(&track[at..]);
            let short = length(&way.path);
            prop_assert!((along_them - short).abs() < 1e-6 && short <= length(&track) + 1e-6 && way.path.last() == track.last());
        }
    }
}
