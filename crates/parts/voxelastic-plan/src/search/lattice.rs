//! A lattice over the planning space. How the robot fits at a node is evaluated on demand and cached.
//!
//! In the air the lattice has three dimensions. On the ground it has one plane of nodes per storey, and a node stores the height of the robot that
//! reached it first.

use crate::points::Point;
use crate::space::{Fit, Space};

/// Node spacing as a multiple of the robot's radius, on the ground and in the air.
const SPACING: [f64; 2] = [0.7, 1.0];
/// Limits of the node spacing, metres.
const SPACING_LIMITS: [f64; 2] = [0.15, 0.5];
/// A node is tight if a ball fits there whose radius is smaller by this share of the spacing: no gap that the robot fits through lies between nodes.
const TIGHT_MARGIN: f64 = 0.5;
/// Most nodes of a lattice; the spacing is increased until there are no more.
const MAX_NODES: f64 = 3e7;
/// Distance between the planes of nodes on the ground, metres: the height of a storey.
const STOREY: f64 = 1.5;
/// In the air, cubes with this many nodes along an edge are tested as a whole first, because most of space is free.
const CUBE: usize = 4;

/// The nodes and what is known of them.
pub(crate) struct Lattice<'a, S> {
    space: &'a S,
    goal: Point,
    /// Distance between nodes along each axis, metres.
    spacing: Point,
    /// Position of the first node.
    low: Point,
    /// Number of nodes along each axis.
    size: [usize; 3],
    /// How the robot fits at each node; none if not evaluated yet.
    fits: Vec<Option<Fit>>,
    /// Whether a cube of nodes was tested as a whole.
    tested_cubes: Vec<bool>,
    /// On the ground, height of the robot's centre at each node.
    heights: Vec<f32>,
}

/// A move to a neighbouring node: offset in nodes, and length in metres.
pub(crate) type Step = ([i8; 3], f32);

impl<'a, S: Space> Lattice<'a, S> {
    /// A lattice with a node at `start`, for a robot of this radius.
    pub(crate) fn new(space: &'a S, start: Point, goal: Point, radius: f64) -> Self {
        let [low, high] = space.bounds();
        let is_flat = space.dimensions() == 2;
        let mut edge = (SPACING[usize::from(!is_flat)] * radius).clamp(SPACING_LIMITS[0], SPACING_LIMITS[1]);
        let layout = |edge: f64| {
            let spacing = [edge, edge, if is_flat { STOREY } else { edge }];
            let before: Point = std::array::from_fn(|k| ((start[k] - low[k]) / spacing[k]).floor().max(0.0));
            let count: Point = std::array::from_fn(|k| before[k] + ((high[k] - start[k]) / spacing[k]).floor().max(0.0) + 1.0);
            (spacing, std::array::from_fn(|k| start[k] - before[k] * spacing[k]), count)
        };
        while layout(edge).2.iter().product::<f64>() > MAX_NODES && edge < 1e9 {
            edge *= 1.2;
        }
        let (spacing, low, count) = layout(edge);
        // Infinite or NaN bounds give an empty lattice.
        let is_finite = count.iter().product::<f64>() <= MAX_NODES;
        let size = count.map(|c| if is_finite { c as usize } else { 0 });
        let nodes = size.iter().product();
        let cubes = if is_flat { 0 } else { size.map(|count: usize| count.div_ceil(CUBE)).iter().product() };
        let heights = if is_flat { vec![0.0; nodes] } else { Vec::new() };
        Self { space, goal, spacing, low, size, fits: vec![None; nodes], tested_cubes: vec![false; cubes], heights }
    }

    /// Number of nodes.
    pub(crate) fn len(&self) -> usize {
        self.fits.len()
    }

    /// Whether the nodes lie on the ground.
    pub(crate) fn is_flat(&self) -> bool {
        !self.heights.is_empty()
    }

    /// Distance between nodes along each axis, metres.
    pub(crate) fn spacing(&self) -> Point {
        self.spacing
    }

    /// How the robot fits at a node, if that was evaluated.
    pub(crate) fn fit(&self, node: usize) -> Option<Fit> {
        self.fits[node]
    }

    /// Replaces the fit of a node by what a search found out.
    pub(crate) fn set_fit(&mut self, node: usize, fit: Fit) {
        self.fits[node] = Some(fit);
    }

    /// On the ground, sets the height of the robot's centre at a node, metres.
    pub(crate) fn set_height(&mut self, node: usize, z: f64) {
        if let Some(height) = self.heights.get_mut(node) {
            *height = z as f32;
        }
    }

    /// The node nearest to `p`; none outside of the lattice.
    pub(crate) fn node_at(&self, p: Point) -> Option<usize> {
        let c: Point = std::array::from_fn(|k| ((p[k] - self.low[k]) / self.spacing[k]).round());
        let is_inside = (0..3).all(|k| c[k] >= 0.0 && c[k] < self.size[k] as f64);
        is_inside.then(|| c[0] as usize + self.size[0] * (c[1] as usize + self.size[1] * c[2] as usize))
    }

    /// Position of the robot's centre at a node.
    pub(crate) fn point(&self, node: usize) -> Point {
        let p = self.point_of(self.coords(node));
        self.heights.get(node).map_or(p, |z| [p[0], p[1], f64::from(*z)])
    }

    /// Lattice coordinates of a node.
    pub(crate) fn coords(&self, node: usize) -> [usize; 3] {
        [node % self.size[0], node / self.size[0] % self.size[1], node / (self.size[0] * self.size[1])]
    }

    fn point_of(&self, c: [usize; 3]) -> Point {
        std::array::from_fn(|k| self.low[k] + c[k] as f64 * self.spacing[k])
    }

    /// The neighbour of the node with coordinates `c` at position `from`, and how the robot fits there; none where it does not.
    pub(crate) fn neighbour(&mut self, c: [usize; 3], from: Point, by: [i8; 3]) -> Option<(usize, Fit)> {
        let node = if self.is_flat() { self.evaluate_on_ground(from, by)? } else { self.evaluate_in_air(c, by)? };
        self.fits[node].filter(|fit| *fit != Fit::Blocked).map(|fit| (node, fit))
    }

    fn evaluate_in_air(&mut self, c: [usize; 3], by: [i8; 3]) -> Option<usize> {
        let next: [usize; 3] = std::array::from_fn(|k| c[k].wrapping_add_signed(isize::from(by[k])));
        if (0..3).any(|k| next[k] >= self.size[k]) {
            return None;
        }
        let node = next[0] + self.size[0] * (next[1] + self.size[1] * next[2]);
        if self.fits[node].is_none() && !self.fill_free_cube(node) {
            self.fits[node] = Some(self.space.fit(self.point_of(next), TIGHT_MARGIN * self.spacing[0]));
        }
        Some(node)
    }

    fn evaluate_on_ground(&mut self, from: Point, by: [i8; 3]) -> Option<usize> {
        let to = self.space.neighbour_state(from, std::array::from_fn(|k| from[k] + f64::from(by[k]) * self.spacing[k]))?;
        let node = self.node_at(to)?;
        if self.fits[node].is_none() {
            self.fits[node] = Some(self.space.fit(to, TIGHT_MARGIN * self.spacing[0]));
            self.heights[node] = to[2] as f32;
        }
        Some(node)
    }

    /// Tests the cube around a node as a whole, once. If the robot fits everywhere in it, marks all its nodes free and returns true.
    fn fill_free_cube(&mut self, node: usize) -> bool {
        let cube = self.coords(node).map(|c| c / CUBE);
        let count = self.size.map(|count| count.div_ceil(CUBE));
        let index = cube[0] + count[0] * (cube[1] + count[1] * cube[2]);
        let is_new = self.tested_cubes.get_mut(index).is_some_and(|tested| !std::mem::replace(tested, true));
        let first = cube.map(|c| c * CUBE);
        let last: [usize; 3] = std::array::from_fn(|k| (first[k] + CUBE).min(self.size[k]) - 1);
        if !is_new || !self.space.is_box_free([self.point_of(first), self.point_of(last)]) {
            return false;
        }
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                let row = self.size[0] * (y + self.size[1] * z);
                self.fits[row + first[0]..=row + last[0]].fill(Some(Fit::Free));
            }
        }
        true
    }

    /// Lower bounds of the length from `p` to the goal, metres: over an empty lattice, and in a straight line.
    pub(crate) fn remaining(&self, p: Point) -> (f32, f64) {
        let count = if self.is_flat() { 2 } else { 3 };
        let mut off: Point = std::array::from_fn(|k| if k < count { (p[k] - self.goal[k]).abs() } else { 0.0 });
        let straight = off.iter().map(|c| c * c).sum::<f64>().sqrt();
        off.sort_unstable_by(f64::total_cmp);
        let [least, middle, most] = off;
        ((least * (3f64.sqrt() - 2f64.sqrt()) + middle * (2f64.sqrt() - 1.0) + most) as f32, straight)
    }

    /// Whether the goal is within about half the spacing of `p`.
    pub(crate) fn is_at_goal(&self, p: Point) -> bool {
        (0..3).all(|k| (p[k] - self.goal[k]).abs() <= 0.51 * self.spacing[k])
    }

    /// The moves to all neighbours of a node: 26 in the air, 8 on the ground.
    pub(crate) fn steps(&self) -> Vec<Step> {
        let is_flat = self.is_flat();
        let all = (0..27i8).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]).filter(|by| *by != [0; 3] && !(is_flat && by[2] != 0));
        all.map(|by| (by, (self.spacing[0] * f64::from(by.iter().map(|c| c * c).sum::<i8>()).sqrt()) as f32)).collect()
    }
}
