//! A graph of places that the robot can reach, on a lattice, kept from plan to plan. Every edge was a free motion when it was added; a path along it is checked again
//! before it is used. The robot's own track may be part of it.

mod extension;

use crate::near_returns::squared_distance;
use crate::routes::retreat;
use crate::routes::shortest::NOBODY;
use hashbrown::HashMap;
use voxelastic_plan::{Point, Space, distance};

/// No node: the way there was found not to be free, and is not tried again.
const BLOCKED: u32 = u32::MAX - 1;
/// Most nodes near the robot that it is joined to.
const JOINED: usize = 8;
/// A metre of the track counts as so many.
const TRACK: f64 = 1.2;
/// Steps to neighbours on the lattice; those of wheels come first.
const STEPS: [[i32; 3]; 10] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0], [0, 0, 1], [0, 0, -1]];

/// A place and its neighbours.
#[derive(Clone, Debug)]
struct Node {
    place: Point,
    key: [i32; 3],
    /// Neighbour in the direction of each step.
    edges: [u32; STEPS.len()],
    /// Whether steps from here have to be tried, or tried again.
    is_stale: bool,
}

/// The graph.
#[derive(Clone, Debug)]
pub(crate) struct Roadmap {
    spacing: f64,
    origin: Point,
    nodes: Vec<Node>,
    by_key: HashMap<[i32; 3], u32>,
    /// Places between two nodes whose edge is not straight, in the order from the first to the second.
    bends: HashMap<[u32; 2], Vec<Point>>,
    /// Lowest and highest key along z.
    layers: [i32; 2],
    /// The robot's track: the node in each cell of it, and the neighbours along it.
    track: HashMap<[i32; 3], u32>,
    links: HashMap<u32, Vec<u32>>,
    /// Neighbours across shortcuts of the track, which the map had free.
    shortcuts: HashMap<u32, Vec<u32>>,
}

impl Roadmap {
    /// An empty graph with neighbours `spacing` metres apart, one of them at `origin`.
    pub fn new(spacing: f64, origin: Point) -> Self {
        Self {
            spacing,
            origin,
            nodes: Vec::new(),
            by_key: HashMap::new(),
            bends: HashMap::new(),
            layers: [0; 2],
            track: HashMap::new(),
            links: HashMap::new(),
            shortcuts: HashMap::new(),
        }
    }

    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    pub fn place(&self, node: u32) -> Point {
        self.nodes[node as usize].place
    }

    /// All nodes and their places.
    #[cfg(test)]
    pub fn places(&self) -> impl Iterator<Item = (u32, Point)> + '_ {
        (0..).zip(self.nodes.iter().map(|node| node.place))
    }

    fn key(&self, p: Point) -> [i32; 3] {
        std::array::from_fn(|k| ((p[k] - self.origin[k]) / self.spacing).round() as i32)
    }

    fn add(&mut self, place: Point) -> u32 {
        let (node, key) = (self.nodes.len() as u32, self.key(place));
        self.by_key.entry(key).or_insert(node);
        self.layers = [self.layers[0].min(key[2]), self.layers[1].max(key[2])];
        self.nodes.push(Node { place, key, edges: [NOBODY; STEPS.len()], is_stale: true });
        node
    }

    /// The places between two neighbours, from the first to the second.
    fn bend(&self, a: u32, b: u32) -> Vec<Point> {
        let there = || self.bends.get(&[a, b]).cloned();
        let back = || self.bends.get(&[b, a]).map(|bend| bend.iter().rev().copied().collect());
        there().or_else(back).unwrap_or_default()
    }

    fn connect(&mut self, a: u32, b: u32, step: usize) {
        self.nodes[a as usize].edges[step] = b;
        let back = STEPS.iter().position(|s| (0..3).all(|k| s[k] == -STEPS[step][k])).unwrap_or(step);
        self.nodes[b as usize].edges[back] = a;
    }

    /// A motion near `at` is not free any more: removes the edges there that are not either. If all of them are, as checks from elsewhere may differ, those that pass next to
    /// it are blocked: not tried again, or each plan would lead there. Shortcuts next to it are removed: the track is still there.
    pub fn block<S: Space>(&mut self, space: &S, at: Point) {
        let Self { nodes, shortcuts, spacing, .. } = self;
        let place = |node: u32| nodes[node as usize].place;
        for (from, ends) in shortcuts {
            ends.retain(|to| squared_distance(at, place(*from), place(*to)) > spacing.powi(2));
        }
        let around: Vec<(u32, usize)> =
            self.near(at, 2.0 * self.spacing).into_iter().flat_map(|node| (0..STEPS.len()).map(move |step| (node, step))).collect();
        let next_to = |roadmap: &Self, node: u32, other: u32| {
            let way = roadmap.way(node, other);
            way.windows(2).any(|ends| squared_distance(at, ends[0], ends[1]) < (0.5 * roadmap.spacing).powi(2))
        };
        let edges: Vec<(u32, usize, u32)> = around
            .into_iter()
            .map(|(node, step)| (node, step, self.nodes[node as usize].edges[step]))
            .filter(|(node, _, other)| *other < BLOCKED && next_to(self, *node, *other))
            .collect();
        let is_free = |(node, _, other): &(u32, usize, u32)| self.way(*node, *other).windows(2).all(|ends| space.is_segment_free(ends[0], ends[1]));
        let shut: Vec<(u32, usize, u32)> = edges.iter().filter(|edge| !is_free(edge)).copied().collect();
        let (removed, mark) = if shut.is_empty() { (&edges, BLOCKED) } else { (&shut, NOBODY) };
        for &(node, _, other) in removed {
            for (from, to) in [(node, other), (other, node)] {
                let from = &mut self.nodes[from as usize];
                from.edges.iter_mut().filter(|edge| **edge == to).for_each(|edge| *edge = mark);
                from.is_stale = true;
            }
        }
    }

    /// The places from a node to a neighbour.
    pub fn way(&self, a: u32, b: u32) -> Vec<Point> {
        let mut way = vec![self.place(a)];
        way.extend(self.bend(a, b));
        way.push(self.place(b));
        way
    }

    /// Has everything that was blocked tried again.
    pub fn unblock(&mut self) {
        for node in &mut self.nodes {
            node.edges.iter_mut().filter(|edge| **edge == BLOCKED).for_each(|edge| {
                *edge = NOBODY;
                node.is_stale = true;
            });
        }
    }

    /// Nodes within `radius` metres of `p`, the nearest first.
    pub fn near(&self, p: Point, radius: f64) -> Vec<u32> {
        let reach = (radius / self.spacing).ceil() as i32;
        let centre = self.key(p);
        let layers = self.layers[0].max(centre[2] - reach)..=self.layers[1].min(centre[2] + reach);
        let keys = layers.flat_map(|z| (-reach..=reach).flat_map(move |y| (-reach..=reach).map(move |x| [centre[0] + x, centre[1] + y, z])));
        let mut found: Vec<(f64, u32)> = keys.filter_map(|key| self.by_key.get(&key)).map(|&node| (distance(self.place(node), p), node)).collect();
        found.retain(|(off, _)| *off <= radius);
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.into_iter().map(|(_, node)| node).collect()
    }

    /// Adds the places where the robot was, in order: it can go from each to the next, and back, whatever the map says. Places in one cell are one place.
    pub fn link(&mut self, track: &[Point]) {
        let mut last = None;
        for place in track {
            let node = self.on_track(*place);
            if let Some(last) = last.replace(node).filter(|last| *last != node) {
                make_neighbours(&mut self.links, last, node);
            }
        }
    }

    /// Adds a straight motion between two places of the track that the map has free.
    pub fn shortcut(&mut self, ends: [Point; 2]) {
        let [from, to] = ends.map(|end| self.on_track(end));
        if from != to {
            make_neighbours(&mut self.shortcuts, from, to);
        }
    }

    /// Whether it has any of those.
    pub fn has_shortcuts(&self) -> bool {
        self.shortcuts.values().any(|ends| !ends.is_empty())
    }

    /// The node of the track at a place, which is added if there is none in its cell.
    fn on_track(&mut self, place: Point) -> u32 {
        let cell = retreat::cell(place);
        if let Some(node) = self.track.get(&cell) {
            return *node;
        }
        let node = self.add(place);
        self.track.insert(cell, node);
        node
    }

    /// Removes a motion along the track.
    pub fn unlink(&mut self, [a, b]: [u32; 2]) {
        for (from, to) in [(a, b), (b, a)] {
            if let Some(links) = self.links.get_mut(&from) {
                links.retain(|other| *other != to);
            }
        }
    }

    /// Whether two neighbours are joined by the track alone.
    pub fn is_link(&self, a: u32, b: u32) -> bool {
        !self.nodes[a as usize].edges.contains(&b) && !self.shortcuts.get(&a).is_some_and(|ends| ends.contains(&b))
    }

    /// Neighbours of a node, and how far away they are, metres: along the track somewhat more, as nothing says what is there now.
    pub fn neighbours(&self, node: u32) -> impl Iterator<Item = (u32, f64)> + '_ {
        let off = move |other: u32| distance(self.place(node), self.place(other));
        let edges = self.nodes[node as usize].edges.iter().filter(|other| **other < BLOCKED).map(move |other| (*other, off(*other)));
        let links = self.links.get(&node).into_iter().flatten().map(move |other| (*other, TRACK * off(*other)));
        let shortcuts = self.shortcuts.get(&node).into_iter().flatten().map(move |other| (*other, off(*other)));
        edges.chain(links).chain(shortcuts)
    }

    /// The nodes that a robot at `from` reaches, the nearest first.
    pub fn joined<S: Space>(&self, space: &S, from: Point) -> Vec<u32> {
        let start = space.state_at(from).unwrap_or(from);
        let reachable = |node: &u32| space.connects(start, self.place(*node)) || distance(from, self.place(*node)) < 1e-6;
        let near = self.near(from, 3.0 * self.spacing).into_iter().filter(reachable).take(JOINED);
        // It has come from where it was last.
        let last = self.track.get(&retreat::cell(from)).copied();
        near.chain(last).collect()
    }

    /// Distance between neighbours, metres.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }
}

/// Makes two nodes neighbours of each other.
fn make_neighbours(neighbours: &mut HashMap<u32, Vec<u32>>, a: u32, b: u32) {
    for (from, to) in [(a, b), (b, a)] {
        let ends = neighbours.entry(from).or_default();
        if !ends.contains(&to) {
            ends.push(to);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::columns::Columns;
    use voxelastic_plan::between;

    /// A wall between x = 0.2 and 0.5 with a gap of 12 cm, through which the robot, a point, can go; it may be shut.
    #[derive(Clone, Debug)]
    struct Gap {
        centre: f64,
        is_shut: bool,
    }

    impl Space for Gap {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            (0..=200).all(|i| self.state_at(between(from, to, f64::from(i) / 200.0)).is_some()).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            let is_in_wall = (0.2..=0.5).contains(&p[0]) && (self.is_shut || (p[1] - self.centre).abs() > 0.06);
            (!is_in_wall && (0..2).all(|k| p[k].abs() <= 2.0) && p[2].abs() < 0.1).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-2.0, -2.0, -0.1], [2.0, 2.0, 0.1]]
        }
    }

    /// A roadmap around a robot before the wall, and the places behind it that can be reached.
    fn grown(space: &Gap) -> (Roadmap, Vec<u32>) {
        let robot = [-1.2, 0.0, 0.0];
        let mut roadmap = Roadmap::new(0.6, robot);
        roadmap.extend_all(space, robot, f64::INFINITY);
        let ways = roadmap.ways(space, robot);
        let behind = roadmap.places().filter(|(node, place)| place[0] > 0.5 && ways.length(*node).is_finite()).map(|(node, _)| node).collect();
        (roadmap, behind)
    }

    #[test]
    fn a_doorway_is_found_wherever_it_is_and_the_way_through_it_is_free() {
        for centre in [0.0, 0.1, 0.17, 0.25, -0.22, -0.3, 0.75] {
            let space = Gap { centre, is_shut: false };
            let (roadmap, behind) = grown(&space);
            assert!(!behind.is_empty(), "gap at {centre}");
            let ways = roadmap.ways(&space, [-1.2, 0.0, 0.0]);
            for node in behind {
                let path = ways.first_part(&roadmap, node).path;
                assert!(path.windows(2).all(|ends| space.is_segment_free(ends[0], ends[1])), "gap at {centre}: {path:?}");
            }
        }
        assert!(grown(&Gap { centre: 0.0, is_shut: true }).1.is_empty());
    }

    #[test]
    fn what_is_shut_is_removed_and_nothing_else() {
        let open = Gap { centre: 0.25, is_shut: false };
        let (mut roadmap, behind) = grown(&open);
        let edges = |roadmap: &Roadmap| roadmap.nodes.iter().flat_map(|node| &node.edges).filter(|edge| **edge < BLOCKED).count();
        let (before, shut) = (edges(&roadmap), Gap { is_shut: true, ..open.clone() });
        roadmap.block(&shut, [0.19, 0.25, 0.0]);
        assert!(before - edges(&roadmap) <= 8, "{before} {}", edges(&roadmap));
        let ways = roadmap.ways(&shut, [-1.2, 0.0, 0.0]);
        assert!(behind.iter().all(|node| ways.length(*node).is_infinite()));
        // The door opens.
        roadmap.extend_all(&open, [-1.2, 0.0, 0.0], f64::INFINITY);
        assert!(roadmap.ways(&open, [-1.2, 0.0, 0.0]).length(behind[0]).is_finite());
        // A check from elsewhere differs: those next to it are blocked until everything is tried again.
        let whole = edges(&roadmap);
        roadmap.block(&open, [-0.6, 0.0, 0.0]);
        let left = edges(&roadmap);
        assert!(left < whole && left > whole / 2, "{left} of {whole}");
        roadmap.extend_all(&open, [-1.2, 0.0, 0.0], f64::INFINITY);
        assert_eq!(edges(&roadmap), left);
        roadmap.unblock();
        roadmap.extend_all(&open, [-1.2, 0.0, 0.0], f64::INFINITY);
        assert_eq!(edges(&roadmap), whole);
    }

    #[test]
    fn what_is_far_is_added_when_the_robot_is_near_and_ways_to_some_are_as_those_to_all() {
        let open = Gap { centre: 0.0, is_shut: false };
        let robot = [-1.8, 0.0, 0.0];
        let (mut near, mut whole) = (Roadmap::new(0.6, robot), Roadmap::new(0.6, robot));
        whole.extend_all(&open, robot, f64::INFINITY);
        near.extend_all(&open, robot, 0.7);
        assert!(
            near.places().all(|(_, place)| distance(place, robot) < 1.4 + 0.9) && 3 * near.len() < 2 * whole.len(),
            "{} of {}",
            near.len(),
            whole.len()
        );
        // It gets there.
        for x in [-1.2, -0.6, 0.0, 0.6, 1.2, 1.8] {
            [-1.8, -0.6, 0.6, 1.8].into_iter().for_each(|y| near.extend_all(&open, [x, y, 0.0], 0.7));
        }
        assert_eq!(near.len(), whole.len());
        let all = whole.ways(&open, robot);
        for nodes in [vec![5], vec![0, 7, whole.len() as u32 - 1], vec![]] {
            let some = whole.ways_to(&open, robot, &nodes);
            assert!(
                nodes.iter().all(|node| some.length(*node) == all.length(*node) && some.first_part(&whole, *node) == all.first_part(&whole, *node))
            );
        }
        let nearest = whole.near(robot, 0.1)[0];
        let some = whole.ways_to(&open, robot, &[nearest]);
        assert!(whole.places().filter(|(node, _)| some.length(*node).is_finite()).count() < whole.len() / 2);
    }

    #[test]
    fn what_was_not_free_is_tried_again_where_something_has_changed() {
        let (robot, shut, open) = ([-1.2, 0.0, 0.0], Gap { centre: 0.05, is_shut: true }, Gap { centre: 0.05, is_shut: false });
        let behind = |changed: Option<[Point; 1]>| {
            let (mut roadmap, _) = grown(&shut);
            let mut columns = Columns::new(0.9);
            changed.iter().flatten().for_each(|centre| columns.add(*centre, 0.1));
            roadmap.retry(changed.map(|_| columns.widened()).as_ref());
            roadmap.extend_all(&open, robot, f64::INFINITY);
            roadmap.places().filter(|(_, place)| place[0] > 0.5).map(|(_, place)| place).collect::<Vec<Point>>()
        };
        assert_eq!((behind(Some([[-1.8, -1.8, 0.0]])).len(), grown(&shut).1.len()), (0, 0));
        assert!(behind(Some([[0.35, 0.05, 0.0]])).len() > 8);
        assert_eq!(behind(Some([[0.35, 0.05, 0.0]])), behind(None));
    }

    #[test]
    fn a_roadmap_that_grows_in_parts_gets_as_far() {
        let (robot, open) = ([-1.2, 0.0, 0.0], Gap { centre: 0.05, is_shut: false });
        let (whole, behind) = grown(&open);
        let mut parts = Roadmap::new(0.6, robot);
        let unfinished = (0..1000).take_while(|_| !parts.extend(&open, robot, f64::INFINITY, 7)).count();
        assert!((20..1000).contains(&unfinished) && behind.len() > 8, "{unfinished} parts");
        let sorted = |roadmap: &Roadmap| {
            let mut keys: Vec<[i32; 3]> = roadmap.nodes.iter().map(|node| node.key).collect();
            keys.sort_unstable();
            keys
        };
        assert_eq!(sorted(&parts), sorted(&whole));
        let ways = parts.ways(&open, robot);
        assert!(parts.places().all(|(node, _)| ways.length(node).is_finite()));
    }
}
