//! A graph of places that the robot can reach, on a lattice, kept from plan to plan. Every edge was a free motion when it was added; a path along it is checked again
//! before it is used.

use hashbrown::HashMap;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use voxelastic_plan::{Point, Space, distance};

/// No node.
pub(crate) const NOBODY: u32 = u32::MAX;
/// Most nodes near the robot that it is joined to.
const JOINED: usize = 8;
/// How far beside a place of the lattice a node may be, in spacings: a doorway that leaves 10 cm of freedom is to be found. Less than half, or
/// it would lie at the neighbour's key, and the place of the lattice would stay empty and be tried for ever.
const ASIDE: [f64; 6] = [-0.33, 0.33, -0.17, 0.17, -0.45, 0.45];
/// Steps to neighbours on the lattice; those of wheels come first.
const STEPS: [[i32; 3]; 10] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0], [0, 0, 1], [0, 0, -1]];

/// A place and its neighbours.
#[derive(Clone, Debug)]
struct Node {
    place: Point,
    key: [i32; 3],
    /// Neighbour in the direction of each step.
    edges: [u32; STEPS.len()],
}

/// The graph.
#[derive(Clone, Debug)]
pub(crate) struct Roadmap {
    spacing: f64,
    origin: Point,
    nodes: Vec<Node>,
    by_key: HashMap<[i32; 3], u32>,
    /// Lowest and highest key along z.
    layers: [i32; 2],
}

/// Lengths of the shortest ways from one place to all nodes.
#[derive(Clone, Debug)]
pub(crate) struct Ways {
    from: Point,
    lengths: Vec<f64>,
    /// The node before each on its way; nobody for those next to the start.
    before: Vec<u32>,
}

impl Roadmap {
    /// An empty graph with neighbours `spacing` metres apart, one of them at `origin`.
    pub fn new(spacing: f64, origin: Point) -> Self {
        Self { spacing, origin, nodes: Vec::new(), by_key: HashMap::new(), layers: [0; 2] }
    }

    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    pub fn place(&self, node: u32) -> Point {
        self.nodes[node as usize].place
    }

    /// All nodes and their places.
    pub fn places(&self) -> impl Iterator<Item = (u32, Point)> + '_ {
        (0..).zip(self.nodes.iter().map(|node| node.place))
    }

    fn key(&self, p: Point) -> [i32; 3] {
        std::array::from_fn(|k| ((p[k] - self.origin[k]) / self.spacing).round() as i32)
    }

    /// Adds what can be reached from the robot and from the nodes within `radius` metres of it.
    pub fn extend<S: Space>(&mut self, space: &S, robot: Point, radius: f64) {
        let steps = if space.dimensions() == 2 { 8 } else { STEPS.len() };
        let mut queue: Vec<u32> = self.places().filter(|(_, place)| distance(*place, robot) < radius).map(|(node, _)| node).collect();
        queue.extend(self.join(space, robot));
        while let Some(node) = queue.pop() {
            for step in 0..steps {
                if self.nodes[node as usize].edges[step] == NOBODY
                    && let Some(new) = self.step(space, node, step)
                {
                    queue.push(new);
                }
            }
        }
    }

    /// Adds a node at the robot if there is none yet.
    fn join<S: Space>(&mut self, space: &S, robot: Point) -> Option<u32> {
        if !self.near(robot, 1.5 * self.spacing).is_empty() {
            return None;
        }
        space.state_at(robot).map(|place| self.add(place))
    }

    fn add(&mut self, place: Point) -> u32 {
        let (node, key) = (self.nodes.len() as u32, self.key(place));
        self.by_key.entry(key).or_insert(node);
        self.layers = [self.layers[0].min(key[2]), self.layers[1].max(key[2])];
        self.nodes.push(Node { place, key, edges: [NOBODY; STEPS.len()] });
        node
    }

    /// Tries one step from a node; returns a node that is new.
    fn step<S: Space>(&mut self, space: &S, node: u32, step: usize) -> Option<u32> {
        let Node { place, key, .. } = self.nodes[node as usize];
        let next: [i32; 3] = std::array::from_fn(|k| key[k] + STEPS[step][k]);
        // Wheels may arrive higher or lower than they started.
        let heights = if space.dimensions() == 2 { [0, 1, -1] } else { [0; 3] };
        let known = heights.into_iter().find_map(|dz| self.by_key.get(&[next[0], next[1], next[2] + dz]).copied());
        if let Some(other) = known {
            if space.connects(place, self.place(other)) {
                self.connect(node, other, step);
            }
            return None;
        }
        let mut to: Point = std::array::from_fn(|k| self.origin[k] + f64::from(next[k]) * self.spacing);
        if space.dimensions() == 2 {
            to[2] = place[2];
        }
        let arrived = space.steer(place, to).or_else(|| self.step_aside(space, place, to, step))?;
        let new = self.add(arrived);
        self.connect(node, new, step);
        Some(new)
    }

    /// Tries to arrive beside the place that a straight step leads to: a doorway is seldom on the lattice.
    fn step_aside<S: Space>(&self, space: &S, place: Point, to: Point, step: usize) -> Option<Point> {
        let across = match STEPS[step] {
            [_, 0, 0] => 1,
            [0, _, 0] => 0,
            _ => return None,
        };
        ASIDE.into_iter().find_map(|aside| {
            let mut to = to;
            to[across] += aside * self.spacing;
            space.steer(place, to)
        })
    }

    fn connect(&mut self, a: u32, b: u32, step: usize) {
        self.nodes[a as usize].edges[step] = b;
        let back = STEPS.iter().position(|s| (0..3).all(|k| s[k] == -STEPS[step][k])).unwrap_or(step);
        self.nodes[b as usize].edges[back] = a;
    }

    /// Removes the edges between nodes that are within half a spacing of the segment from `a` to `b`: it is not free any more.
    pub fn block(&mut self, a: Point, b: Point) {
        let reach = 1.5 * self.spacing;
        let near: Vec<u32> = self.near(a, reach).into_iter().chain(self.near(b, reach)).collect();
        for &node in &near {
            for step in 0..STEPS.len() {
                let other = self.nodes[node as usize].edges[step];
                if other != NOBODY && near.contains(&other) {
                    self.nodes[node as usize].edges[step] = NOBODY;
                }
            }
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

    /// The shortest ways from a place that the robot can be at.
    pub fn ways<S: Space>(&self, space: &S, from: Point) -> Ways {
        let mut ways = Ways { from, lengths: vec![f64::INFINITY; self.nodes.len()], before: vec![NOBODY; self.nodes.len()] };
        let mut heap = BinaryHeap::new();
        let start = space.state_at(from).unwrap_or(from);
        let reachable = |node: &u32| space.connects(start, self.place(*node)) || distance(from, self.place(*node)) < 1e-6;
        for node in self.near(from, 3.0 * self.spacing).into_iter().filter(reachable).take(JOINED) {
            let length = distance(from, self.place(node));
            ways.lengths[node as usize] = length;
            heap.push(Reverse((Length(length), node)));
        }
        while let Some(Reverse((Length(length), node))) = heap.pop() {
            if length > ways.lengths[node as usize] {
                continue;
            }
            for &next in self.nodes[node as usize].edges.iter().filter(|next| **next != NOBODY) {
                let length = length + distance(self.place(node), self.place(next));
                if length < ways.lengths[next as usize] {
                    (ways.lengths[next as usize], ways.before[next as usize]) = (length, node);
                    heap.push(Reverse((Length(length), next)));
                }
            }
        }
        ways
    }
}

impl Ways {
    /// Length of the way to a node, metres; infinite if there is none.
    pub fn length(&self, node: u32) -> f64 {
        self.lengths[node as usize]
    }

    /// Whether any node can be reached.
    pub fn lead_anywhere(&self) -> bool {
        self.lengths.iter().any(|length| length.is_finite())
    }

    /// The way to a node, from the start.
    pub fn path(&self, roadmap: &Roadmap, node: u32) -> Vec<Point> {
        let mut path: Vec<Point> = std::iter::successors(Some(node), |node| Some(self.before[*node as usize]).filter(|before| *before != NOBODY))
            .map(|node| roadmap.place(node))
            .collect();
        path.push(self.from);
        path.reverse();
        path
    }
}

/// A length with a total order.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Length(f64);

impl Eq for Length {}

impl PartialOrd for Length {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Length {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}
