//! Shortest ways in a roadmap.

use crate::routes::roadmap::Roadmap;
use crate::routes::shortest::{Shortest, shortest};
use hashbrown::HashSet;
use voxelastic_plan::{Point, Space, distance};

/// Lengths of the shortest ways from one place to all nodes.
#[derive(Clone, Debug)]
pub(crate) struct Ways {
    from: Point,
    shortest: Shortest,
}

/// The first part of a way: motions that the map has free, or some along the robot's track, which the map may have shut since.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    /// From the start on.
    pub path: Vec<Point>,
    /// Whether it follows the track.
    pub is_track: bool,
    /// Whether that is all of the way.
    pub is_whole: bool,
    /// Its first two nodes.
    pub link: [u32; 2],
}

impl Roadmap {
    /// The shortest ways from a place that the robot can be at.
    pub fn ways<S: Space>(&self, space: &S, from: Point) -> Ways {
        self.ways_until(space, from, |_| false)
    }

    /// The shortest ways to some nodes: those to others may be longer than need be, or missing.
    pub fn ways_to<S: Space>(&self, space: &S, from: Point, nodes: &[u32]) -> Ways {
        let mut left: HashSet<u32> = nodes.iter().copied().collect();
        self.ways_until(space, from, |node| left.remove(&node) && left.is_empty())
    }

    /// The shortest ways, the nearest nodes first, until `is_done` with one.
    fn ways_until<S: Space>(&self, space: &S, from: Point, is_done: impl FnMut(u32) -> bool) -> Ways {
        let starts = self.joined(space, from).into_iter().map(|node| (node, distance(from, self.place(node))));
        Ways { from, shortest: shortest(self.len(), starts, |node| self.neighbours(node), is_done) }
    }
}

impl Ways {
    /// Length of the way to a node, metres; infinite if there is none.
    pub fn length(&self, node: u32) -> f64 {
        self.shortest.lengths[node as usize]
    }

    /// Whether any node can be reached.
    pub fn lead_anywhere(&self) -> bool {
        self.shortest.lengths.iter().any(|length| length.is_finite())
    }

    /// The first part of the way to a node, from the start.
    pub fn first_part(&self, roadmap: &Roadmap, node: u32) -> Part {
        let nodes = self.shortest.path(node);
        let is_near = |node: u32, reach: f64| distance(self.from, roadmap.place(node)) < reach;
        let is_link: Vec<bool> = nodes.windows(2).map(|pair| roadmap.is_link(pair[0], pair[1])).collect();
        let motions = is_link.iter().take_while(|link| !**link).count();
        // It may not be able to move as little as to a place of the track where it is already, but to another one and back, again and again.
        let comes_back = motions > 0 && motions < is_link.len() && is_near(nodes[motions], 0.5 * roadmap.spacing());
        let first = if comes_back { motions } else { 0 };
        let (nodes, is_link) = (&nodes[first..], &is_link[first..]);
        let is_track = is_link.first() == Some(&true) && is_near(nodes[0], roadmap.spacing());
        let steps = is_link.iter().take_while(|link| **link == is_track).count();
        let mut path = vec![self.from];
        if !is_track {
            path.push(roadmap.place(nodes[0]));
        }
        for pair in nodes.windows(2).take(steps) {
            path.extend(roadmap.way(pair[0], pair[1]).into_iter().skip(1));
        }
        Part { path, is_track, is_whole: steps == is_link.len(), link: [nodes[0], nodes.get(1).copied().unwrap_or(nodes[0])] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A shut wall between x = 0.2 and 0.5 in a box of 4 m, for a robot that is a point.
    #[derive(Clone, Debug)]
    struct Wall;

    impl Space for Wall {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            let is_through = from[0].min(to[0]) < 0.5 && from[0].max(to[0]) > 0.2;
            (!is_through && self.state_at(to).is_some()).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            (!(0.2..=0.5).contains(&p[0]) && (0..2).all(|k| p[k].abs() <= 2.0) && p[2].abs() < 0.1).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-2.0, -2.0, -0.1], [2.0, 2.0, 0.1]]
        }
    }

    #[test]
    fn the_track_leads_where_the_map_is_shut_part_by_part() {
        let robot = [-1.2, 0.0, 0.0];
        let mut roadmap = Roadmap::new(0.6, robot);
        roadmap.extend_all(&Wall, robot, f64::INFINITY);
        let is_behind = |roadmap: &Roadmap| roadmap.places().filter(|(_, place)| place[0] > 0.5).map(|(node, _)| node).collect::<Vec<u32>>();
        assert_eq!(is_behind(&roadmap), [0; 0]);
        // It has been behind the wall, when there was a door, with a loop on the way.
        let track: Vec<Point> = [[-0.4, -0.8], [-0.4, -1.4], [-0.4, -0.8], [0.1, -0.8], [0.6, -0.8], [1.2, -0.8]].map(|[x, y]| [x, y, 0.0]).to_vec();
        roadmap.link(&track);
        roadmap.link(&track);
        roadmap.extend_all(&Wall, robot, f64::INFINITY);
        let behind = is_behind(&roadmap);
        let ways = roadmap.ways(&Wall, robot);
        assert!(behind.len() > 8 && behind.iter().all(|node| ways.length(*node).is_finite()), "{behind:?}");
        let goal = roadmap.near([1.8, 1.2, 0.0], 0.5)[0];
        // To the track, along it, and on from there.
        let (mut at, mut parts) = (robot, Vec::new());
        loop {
            let part = roadmap.ways(&Wall, at).first_part(&roadmap, goal);
            assert!(part.path[0] == at && part.path.windows(2).all(|ends| part.is_track || Wall.steer(ends[0], ends[1]).is_some()), "{part:?}");
            at = part.path[part.path.len() - 1];
            parts.push(part.is_track);
            if part.is_whole {
                break;
            }
        }
        assert_eq!((parts.as_slice(), at), ([false, true, false].as_slice(), roadmap.place(goal)));
        // Where the robot is not let through, there is no way.
        let through = roadmap.ways(&Wall, [0.1, -0.8, 0.0]).first_part(&roadmap, goal);
        assert!(through.is_track);
        roadmap.unlink(through.link);
        assert!(roadmap.ways(&Wall, robot).length(goal).is_infinite());
    }

    /// The same for a robot that does not move by less than a few centimetres.
    #[derive(Clone, Debug)]
    struct Coarse;

    impl Space for Coarse {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            Wall.steer(from, to).filter(|_| distance(from, to) > 0.05)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            Wall.state_at(p)
        }

        fn bounds(&self) -> [Point; 2] {
            Wall.bounds()
        }
    }

    #[test]
    fn a_robot_that_stands_at_its_track_goes_along_it() {
        // In front of the wall, a centimetre from a place of the track, and in another cell than that.
        let at = |x: f64| [x, -0.8, 0.0];
        let robot = (0..100)
            .map(|k| at(0.002 * f64::from(k)))
            .find(|p| crate::routes::retreat::cell(*p) != crate::routes::retreat::cell(at(p[0] - 0.01)))
            .unwrap();
        let mut roadmap = Roadmap::new(0.6, [-1.2, 0.0, 0.0]);
        let track = [at(robot[0] - 0.01), at(0.6), at(1.2)];
        roadmap.link(&track);
        roadmap.extend_all(&Coarse, [-1.2, 0.0, 0.0], f64::INFINITY);
        let goal = roadmap.near(track[2], 0.1)[0];
        let part = roadmap.ways(&Coarse, robot).first_part(&roadmap, goal);
        assert!(part.is_track && part.path == [robot, track[1]], "through the wall: {part:?}");
    }

    #[test]
    fn a_shortcut_of_the_track_is_a_motion_until_it_is_shut() {
        let ends = [[-1.8, -1.2, 0.0], [-1.8, 1.2, 0.0]];
        let track = [ends[0], [-1.2, -1.2, 0.0], [-0.6, -1.2, 0.0], [-0.6, 0.0, 0.0], [-0.6, 1.2, 0.0], [-1.2, 1.2, 0.0], ends[1]];
        let mut roadmap = Roadmap::new(0.6, [9.0, 9.0, 0.0]);
        roadmap.link(&track);
        assert!(!roadmap.has_shortcuts());
        roadmap.shortcut(ends);
        let goal = roadmap.near(ends[1], 0.1)[0];
        let ways = roadmap.ways(&Wall, ends[0]);
        let part = ways.first_part(&roadmap, goal);
        assert!((ways.length(goal) - 2.4).abs() < 1e-9 && !part.is_track && part.is_whole, "{} m, {part:?}", ways.length(goal));
        // Something stands beside the track, and then on the shortcut.
        roadmap.block(&Wall, [-0.6, 0.4, 0.0]);
        assert!(roadmap.has_shortcuts());
        roadmap.block(&Wall, [-1.8, 0.1, 0.0]);
        let ways = roadmap.ways(&Wall, ends[0]);
        assert!(!roadmap.has_shortcuts() && ways.length(goal) > 4.0, "{} m", ways.length(goal));
    }
}
