//! How a roadmap grows: steps from place to place, tried once, and again where something has changed.

use super::{NOBODY, Node, Roadmap, STEPS};
use crate::targets::columns::Columns;
use voxelastic_plan::{Point, Space, distance};

/// How far beside a place of the lattice a node may be, in spacings: a doorway that leaves 10 cm of freedom is to be found. Less than half, or
/// it would lie at the neighbour's key, and the place of the lattice would stay empty and be tried for ever.
const ASIDE: [f64; 6] = [-0.33, 0.33, -0.17, 0.17, -0.45, 0.45];

impl Roadmap {
    /// Adds what can be reached from the robot and from the nodes within `radius` metres of it, and not much farther than twice that away: in a large map, what is far is
    /// not tried again whenever the roadmap is new. Steps that were found not to be free are tried again where something has [changed](Self::retry). At most `most` steps are
    /// tried; false if there are more to try: the next call goes on.
    pub fn extend<S: Space>(&mut self, space: &S, robot: Point, radius: f64, most: usize) -> bool {
        let (steps, mut left) = (if space.dimensions() == 2 { 8 } else { STEPS.len() }, most);
        let mut queue: Vec<u32> = self.stale(robot, radius).collect();
        queue.extend(self.join(space, robot));
        while let Some(node) = queue.pop() {
            for step in 0..steps {
                if self.nodes[node as usize].edges[step] != NOBODY {
                    continue;
                }
                let Some(fewer) = left.checked_sub(1) else { return false };
                left = fewer;
                if let Some(new) = self.step(space, node, step)
                    && distance(self.place(new), robot) < 2.0 * radius
                {
                    queue.push(new);
                }
            }
            self.nodes[node as usize].is_stale = false;
        }
        true
    }

    /// [Extends](Self::extend) it by everything.
    #[cfg(test)]
    pub fn extend_all<S: Space>(&mut self, space: &S, robot: Point, radius: f64) {
        assert!(self.extend(space, robot, radius, usize::MAX));
    }

    /// Nodes within `radius` metres of the robot from which steps have to be tried.
    fn stale(&self, robot: Point, radius: f64) -> impl Iterator<Item = u32> + '_ {
        let is_stale = move |node: &Node| node.is_stale && distance(node.place, robot) < radius;
        (0..).zip(&self.nodes).filter(move |(_, node)| is_stale(node)).map(|(node, _)| node)
    }

    /// Whether [`extend`](Self::extend) has nothing to do.
    pub fn is_extended(&self, robot: Point, radius: f64) -> bool {
        self.stale(robot, radius).next().is_none()
    }

    /// Has steps that were found not to be free tried again where something has changed, or everywhere.
    pub fn retry(&mut self, changed: Option<&Columns>) {
        for node in &mut self.nodes {
            node.is_stale |= changed.is_none_or(|changed| changed.has(node.place));
        }
    }

    /// Adds a node at the robot if there is none yet.
    fn join<S: Space>(&mut self, space: &S, robot: Point) -> Option<u32> {
        if !self.near(robot, 1.5 * self.spacing).is_empty() {
            return None;
        }
        space.state_at(robot).map(|place| self.add(place))
    }

    /// Tries one step from a node; returns a node that is new.
    fn step<S: Space>(&mut self, space: &S, node: u32, step: usize) -> Option<u32> {
        let Node { place, key, .. } = self.nodes[node as usize];
        let next: [i32; 3] = std::array::from_fn(|k| key[k] + STEPS[step][k]);
        // Wheels may arrive higher or lower than they started.
        let heights = if space.dimensions() == 2 { [0, 1, -1] } else { [0; 3] };
        let known = heights.into_iter().find_map(|dz| self.by_key.get(&[next[0], next[1], next[2] + dz]).copied());
        let mut to: Point = std::array::from_fn(|k| self.origin[k] + f64::from(next[k]) * self.spacing);
        if space.dimensions() == 2 {
            to[2] = place[2];
        }
        if let Some(other) = known {
            if space.connects(place, self.place(other)) {
                self.connect(node, other, step);
            } else if let Some(bend) = self.bend_to(space, place, (self.place(other), to), step) {
                self.connect(node, other, step);
                self.bends.insert([node, other], bend);
            }
            return None;
        }
        let straight = || space.steer(place, to).or_else(|| self.asides(to, to, step).into_iter().find_map(|to| space.steer(place, to)));
        if let Some(arrived) = straight() {
            let new = self.add(arrived);
            self.connect(node, new, step);
            return Some(new);
        }
        let (bend, arrived) = self.step_aside(space, place, to, step)?;
        let new = self.add(arrived);
        self.connect(node, new, step);
        self.bends.insert([node, new], vec![bend]);
        Some(new)
    }

    /// `p` moved beside the lattice's line through `line`, across a step: a doorway is seldom on the lattice.
    fn asides(&self, p: Point, line: Point, step: usize) -> Vec<Point> {
        let across = match STEPS[step] {
            [_, 0, 0] => 1,
            [0, _, 0] => 0,
            _ => return Vec::new(),
        };
        let moved = |aside: f64| {
            let mut p = p;
            p[across] = line[across] + aside * self.spacing;
            p
        };
        ASIDE.into_iter().map(moved).collect()
    }

    /// A step that goes aside first and then straight ahead, as into a doorway: where it turns, and where it arrives.
    fn step_aside<S: Space>(&self, space: &S, place: Point, to: Point, step: usize) -> Option<(Point, Point)> {
        self.asides(place, to, step).into_iter().zip(self.asides(to, to, step)).find_map(|(aside, ahead)| {
            let bend = space.steer(place, aside)?;
            Some((bend, space.steer(bend, ahead)?))
        })
    }

    /// Where a way to a node turns that goes aside, straight ahead, and back.
    fn bend_to<S: Space>(&self, space: &S, place: Point, (other, line): (Point, Point), step: usize) -> Option<Vec<Point>> {
        self.asides(place, line, step).into_iter().zip(self.asides(other, line, step)).find_map(|(aside, ahead)| {
            let first = space.steer(place, aside)?;
            let second = space.steer(first, ahead)?;
            space.connects(second, other).then(|| vec![first, second])
        })
    }
}
