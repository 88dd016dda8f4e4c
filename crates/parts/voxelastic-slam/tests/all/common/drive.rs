//! Made-up drives: odometry with drift, and closures where the route comes by again.

use super::numbers::Numbers;
use std::f64::consts::FRAC_PI_2;
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;

/// A drive over a grid of streets.
pub struct Drive {
    pub truth: Vec<Pose>,
    pub odometry: Vec<Pose>,
    /// Closures, by the later node, in order.
    pub closures: Vec<Edge>,
}

/// Edge of a block of houses in steps, and blocks on a side of the town.
const BLOCK: usize = 40;
const TOWN: f64 = 6.0;

/// `nodes` poses a metre apart. A closure comes at every `every`th node that is where the drive was before.
pub fn drive(nodes: usize, every: usize, seed: u64) -> Drive {
    let mut numbers = Numbers(seed);
    let (mut truth, mut odometry) = (vec![Pose::identity()], vec![Pose::identity()]);
    let (mut heading, side) = (0.0f64, BLOCK as f64 * TOWN / 2.0);
    for i in 1..nodes {
        let last = truth[i - 1];
        let mut turn = 0.0;
        if i.is_multiple_of(BLOCK) {
            let ahead =
                |turn: f64| last.translation.vector.xy() + BLOCK as f64 * nalgebra::Vector2::new((heading + turn).cos(), (heading + turn).sin());
            let turns = [0.0, FRAC_PI_2, -FRAC_PI_2].map(|t| (t, ahead(t).amax() <= side + 1.0, numbers.next()));
            turn = turns.into_iter().filter(|t| t.1).max_by(|a, b| a.2.total_cmp(&b.2)).map_or(FRAC_PI_2, |t| t.0);
            heading += turn;
        }
        let step = Pose::new(nalgebra::Vector3::zeros(), nalgebra::Vector3::z() * turn) * Pose::translation(1.0, 0.0, 0.0);
        let mut next = last * step;
        next.rotation.renormalize();
        truth.push(next);
        let mut drifted = odometry[i - 1] * step * numbers.motion(0.01, 0.001);
        drifted.rotation.renormalize();
        odometry.push(drifted);
    }
    let mut closures = Vec::new();
    for later in 100..nodes {
        let is_here = |j: &usize| truth[*j].translation_distance(&truth[later]) < 1.5;
        if let Some(earlier) = (0..later - 99).find(is_here).filter(|_| later.is_multiple_of(every)) {
            let t_from_to = truth[earlier].inv_mul(&truth[later]) * numbers.motion(0.05, 0.002);
            closures.push(Edge { from: earlier as NodeId, to: later as NodeId, t_from_to, information: Some(information(0.05, 0.002)) });
        }
    }
    Drive { truth, odometry, closures }
}

/// Information of these standard deviations.
pub fn information(metres: f64, radians: f64) -> [f64; 21] {
    let mut information = [0.0; 21];
    [0, 6, 11, 15, 18, 20].into_iter().enumerate().for_each(|(k, at)| {
        let sigma = if k < 3 { metres } else { radians };
        information[at] = 1.0 / (sigma * sigma);
    });
    information
}

impl Drive {
    /// The odometry edge that leads to a node.
    pub fn odometry_edge(&self, to: usize) -> Edge {
        let t_from_to = self.odometry[to - 1].inv_mul(&self.odometry[to]);
        Edge { from: to as NodeId - 1, to: to as NodeId, t_from_to, information: Some(information(0.01, 0.001)) }
    }

    /// What comes with a node: its scan, its odometry edge, and its closures.
    pub fn events(&self, node: usize) -> Vec<Event> {
        let scan = Scan { node: node as NodeId, time: node as f64, t_map_lidar: self.odometry[node], cloud: Default::default() };
        let mut events = vec![Event::Scan(scan)];
        if node > 0 {
            events.push(Event::OdometryEdge(self.odometry_edge(node)));
        }
        events.extend(self.closures.iter().filter(|c| c.to == node as NodeId).cloned().map(Event::LoopEdge));
        events
    }
}
