//! The robot's track as a graph, for the shortest way along it: places where it was, and straight motions across where it passes near itself.

use crate::routes::retreat;
use crate::routes::shortest::shortest;
use hashbrown::HashMap;
use voxelastic_plan::{Point, Space, distance};

/// Motions from one pass of the track to another are at most this long, metres.
const LONGEST: f64 = 15.0;
/// They begin and end at places this far apart along the track, metres.
const PLACE_SPACING: f64 = 2.0;
/// A motion that saves less than this, metres, or less than this share of its length, is not worth a check.
const LEAST_SAVED: (f64, f64) = (2.0, 0.2);
/// Motions that are checked against the map, at most: in a maze most of those that would help lead through a wall.
const MOST_CHECKS: usize = 200;

/// A way along the track.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TrackWay {
    /// From the robot to the first place of the track.
    pub places: Vec<Point>,
    /// For each motion between two of them, whether it crosses from one pass of the track to another: the map has it free.
    pub is_crossing: Vec<bool>,
}

/// A motion from one pass of the track to another.
#[derive(Clone, Copy, Debug)]
struct Crossing {
    ends: [u32; 2],
    length: f64,
    /// Whether the map has it free; none as long as it was not checked.
    is_free: Option<bool>,
}

/// Places in one cell are one node; the first is where the track begins.
#[derive(Debug, Default)]
struct TrackGraph {
    places: Vec<Point>,
    /// Where the robot is.
    robot: u32,
    /// Neighbours along the track.
    links: Vec<Vec<u32>>,
    crossings: Vec<Crossing>,
    /// The crossings that end at each node.
    crossings_of: Vec<Vec<u32>>,
}

/// The shortest way from the robot, which came along `track`, back to where that begins. A crossing is checked only when it is on what would be the shortest way, so that
/// few have to be.
pub(crate) fn track_way<S: Space>(space: &S, track: &[Point], robot: Point) -> TrackWay {
    let mut graph = TrackGraph::new(track, robot);
    let mut checks = 0;
    loop {
        let nodes = graph.shortest_path(checks < MOST_CHECKS);
        let crossings: Vec<Option<u32>> = nodes.windows(2).map(|ends| graph.crossing(ends[0], ends[1])).collect();
        let mut is_free = true;
        for crossing in crossings.iter().flatten() {
            let [from, to] = graph.crossings[*crossing as usize].ends.map(|end| graph.places[end as usize]);
            let crossing = &mut graph.crossings[*crossing as usize];
            is_free &= *crossing.is_free.get_or_insert_with(|| {
                checks += 1;
                space.connects(from, to)
            });
        }
        if is_free {
            let places = nodes.iter().map(|node| graph.places[*node as usize]).collect();
            return TrackWay { places, is_crossing: crossings.iter().map(Option::is_some).collect() };
        }
    }
}

impl TrackGraph {
    fn new(track: &[Point], robot: Point) -> Self {
        let mut graph = Self::default();
        let mut by_cell: HashMap<[i32; 3], u32> = HashMap::new();
        // Some of the places, with how far along the track they are.
        let mut stops: Vec<(u32, f64)> = Vec::new();
        let (mut along, mut last): (f64, Option<u32>) = (0.0, None);
        for (k, place) in track.iter().chain([&robot]).enumerate() {
            let is_robot = k == track.len();
            let cell = retreat::cell(*place);
            let known = by_cell.get(&cell).copied();
            let is_there = |known: &u32| !is_robot || distance(graph.places[*known as usize], robot) < 1e-3;
            let node = known.filter(is_there).unwrap_or_else(|| graph.add(*place));
            by_cell.entry(cell).or_insert(node);
            // The robot may be where it was before.
            for other in last.into_iter().chain(known).filter(|other| *other != node) {
                graph.link(other, node);
            }
            along += last.map_or(0.0, |last| distance(graph.places[last as usize], graph.places[node as usize]));
            if is_robot || stops.last().is_none_or(|(_, before)| along - before >= PLACE_SPACING) {
                stops.push((node, along));
            }
            (last, graph.robot) = (Some(node), node);
        }
        graph.cross(&stops);
        graph
    }

    fn add(&mut self, place: Point) -> u32 {
        self.places.push(place);
        self.links.push(Vec::new());
        self.crossings_of.push(Vec::new());
        self.places.len() as u32 - 1
    }

    fn link(&mut self, a: u32, b: u32) {
        if !self.links[a as usize].contains(&b) {
            self.links[a as usize].push(b);
            self.links[b as usize].push(a);
        }
    }

    /// Adds the crossings that may be worth it: from each of the places to the nearest place of each pass before.
    fn cross(&mut self, stops: &[(u32, f64)]) {
        let place = |graph: &Self, k: usize| graph.places[stops[k].0 as usize];
        let cell = |p: Point| p.map(|c| (c / LONGEST).floor() as i32);
        let mut before: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
        for k in 0..stops.len() {
            let centre = cell(place(self, k));
            let around = (0..27).map(|i| [centre[0] + i % 3 - 1, centre[1] + i / 3 % 3 - 1, centre[2] + i / 9 - 1]);
            let off = |other: usize| distance(place(self, k), place(self, other));
            let is_worth = |other: &usize| {
                let (length, along) = (off(*other), stops[k].1 - stops[*other].1);
                length < LONGEST && along - length > LEAST_SAVED.0.max(LEAST_SAVED.1 * length)
            };
            let mut near: Vec<usize> = around.filter_map(|cell| before.get(&cell)).flatten().copied().filter(is_worth).collect();
            near.sort_unstable();
            let passes = near.chunk_by(|a, b| a + 1 == *b);
            let nearest: Vec<usize> = passes.filter_map(|pass| pass.iter().copied().min_by(|a, b| off(*a).total_cmp(&off(*b)))).collect();
            nearest.into_iter().for_each(|other| self.add_crossing([stops[k].0, stops[other].0]));
            before.entry(centre).or_default().push(k);
        }
    }

    fn add_crossing(&mut self, ends: [u32; 2]) {
        let [a, b] = ends.map(|end| end as usize);
        // Once each: the track may come by again and again.
        if a != b && !self.links[a].contains(&ends[1]) && self.crossing(ends[0], ends[1]).is_none() {
            let crossing = self.crossings.len() as u32;
            self.crossings.push(Crossing { ends, length: distance(self.places[a], self.places[b]), is_free: None });
            self.crossings_of[a].push(crossing);
            self.crossings_of[b].push(crossing);
        }
    }

    /// The nodes from the robot to the first place, over crossings that are free, and with `unchecked` over those that were not checked, too.
    fn shortest_path(&self, unchecked: bool) -> Vec<u32> {
        let neighbours = |node: u32| {
            let off = move |other: u32| distance(self.places[node as usize], self.places[other as usize]);
            let links = self.links[node as usize].iter().map(move |other| (*other, off(*other)));
            let crossings = self.crossings_of[node as usize].iter().map(|crossing| self.crossings[*crossing as usize]);
            let crossings = crossings.filter(move |crossing| crossing.is_free.unwrap_or(unchecked));
            links.chain(crossings.map(move |crossing| (crossing.other(node), crossing.length)))
        };
        shortest(self.places.len(), [(self.robot, 0.0)], neighbours, |node| node == 0).path(0)
    }

    /// The crossing between two nodes that are neighbours, if they are none along the track.
    fn crossing(&self, a: u32, b: u32) -> Option<u32> {
        let is_it = |crossing: &u32| self.crossings[*crossing as usize].other(a) == b;
        if self.links[a as usize].contains(&b) { None } else { self.crossings_of[a as usize].iter().copied().find(is_it) }
    }
}

impl Crossing {
    fn other(&self, node: u32) -> u32 {
        self.ends[usize::from(self.ends[0] == node)]
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use voxelastic_plan::{between, length};

    /// A plane with a wall along y = 0.5 that has a gap between x = 9 and 11.
    pub(crate) struct Plane;

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

    /// The places from each of `ends` to the next, half a metre apart, and the robot at the last of them.
    pub(crate) fn along(ends: &[[f64; 2]]) -> (Vec<Point>, Point) {
        let ends: Vec<Point> = ends.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
        let mut places = vec![ends[0]];
        for pair in ends.windows(2) {
            let n = (distance(pair[0], pair[1]) / 0.5).ceil().max(1.0) as usize;
            places.extend((1..=n).map(|k| between(pair[0], pair[1], k as f64 / n as f64)));
        }
        let robot = places.pop().unwrap();
        (places, robot)
    }

    /// The slow way: all crossings are checked, and all edges relaxed until nothing gets shorter.
    fn slowly<S: Space>(space: &S, track: &[Point], robot: Point) -> f64 {
        let graph = TrackGraph::new(track, robot);
        let place = |node: u32| graph.places[node as usize];
        let links = (0..).zip(&graph.links).flat_map(|(a, links)| links.iter().map(move |b| [a, *b]));
        let free = graph.crossings.iter().map(|crossing| crossing.ends).filter(|[a, b]| space.connects(place(*a), place(*b)));
        let edges: Vec<[u32; 2]> = links.chain(free).collect();
        let mut lengths = vec![f64::INFINITY; graph.places.len()];
        lengths[graph.robot as usize] = 0.0;
        loop {
            let before = lengths.clone();
            for &[a, b] in &edges {
                let off = distance(place(a), place(b));
                for (from, to) in [(a, b), (b, a)] {
                    lengths[to as usize] = lengths[to as usize].min(lengths[from as usize] + off);
                }
            }
            if lengths == before {
                return lengths[0];
            }
        }
    }

    #[test]
    fn a_robot_that_came_by_near_its_home_goes_home_from_there() {
        // Once around a block, by 6 m from home, and along the other side again, where it has been before: from there the first lap is 240 m.
        let (track, robot) =
            along(&[[0.0, -7.0], [-10.0, 60.0], [90.0, 60.0], [90.0, -14.0], [0.0, -14.0], [-2.0, -13.5], [85.0, -13.0], [90.0, -10.0]]);
        let way = track_way(&Plane, &track, robot);
        assert!(length(&retreat::track(&track, robot)) > 200.0);
        assert!(length(&way.places) < 110.0 && way.is_crossing.iter().any(|is| *is), "{} m", length(&way.places));
        assert_eq!((way.places[0], way.places[way.places.len() - 1]), (robot, track[0]));
        // A robot that has not moved is at home.
        let here = TrackWay { places: vec![robot], is_crossing: Vec::new() };
        assert_eq!([track_way(&Plane, &[], robot), track_way(&Plane, &[robot], robot)], [here.clone(), here]);
    }

    /// Nothing is free, and it counts who asks.
    struct Shut(AtomicUsize);

    impl Space for Shut {
        fn steer(&self, _: Point, _: Point) -> Option<Point> {
            self.0.fetch_add(1, Ordering::Relaxed);
            None
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            Some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            Plane.bounds()
        }
    }

    #[test]
    fn where_nothing_crosses_it_follows_the_track_after_some_checks() {
        // 70 rows of 100 m, 3 m apart.
        let ends: Vec<[f64; 2]> = (0..140).map(|k| [if k % 4 == 0 || k % 4 == 3 { 0.0 } else { 100.0 }, 3.0 * f64::from(k / 2)]).collect();
        let (track, robot) = along(&ends);
        let space = Shut(AtomicUsize::new(0));
        let way = track_way(&space, &track, robot);
        assert!(way.is_crossing.iter().all(|is| !is) && length(&way.places) > 6_900.0);
        let checks = space.0.into_inner();
        assert!((MOST_CHECKS..2 * MOST_CHECKS).contains(&checks), "{checks}");
    }

    proptest! {
        #[test]
        fn the_way_is_the_shortest_and_what_crosses_is_free(ends in prop::collection::vec(prop::array::uniform2(-30.0f64..30.0), 2..9)) {
            let (track, robot) = along(&ends);
            let way = track_way(&Plane, &track, robot);
            let metres = length(&way.places);
            prop_assert!((metres - slowly(&Plane, &track, robot)).abs() < 1e-6);
            prop_assert!(metres <= length(&retreat::track(&track, robot)) + 1e-6);
            prop_assert_eq!(way.is_crossing.len() + 1, way.places.len());
            for (ends, is_crossing) in way.places.windows(2).zip(&way.is_crossing) {
                // Along the track from cell to cell, half a metre apart.
                let is_step = distance(ends[0], ends[1]) < 2.0;
                prop_assert!(is_step || *is_crossing && Plane.connects(ends[0], ends[1]), "{:?}", ends);
            }
            prop_assert_eq!((way.places[0], way.places[way.places.len() - 1]), (robot, track[0]));
        }
    }
}
