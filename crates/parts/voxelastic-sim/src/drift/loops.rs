//! Loop closures between nodes near each other.

use super::gaussian::{information, random_motion};
use super::odometry::path_lengths;
use crate::random::Stream;
use crate::{SimError, World};
use serde::{Deserialize, Serialize};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};

/// Settings of loop closures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LoopSettings {
    /// Farthest distance between two nodes of a loop edge, metres. Zero: no loop edges.
    pub radius: f64,
    /// Least path length between the two nodes, metres.
    pub least_path: f64,
    /// Least path length between two loop edges, metres.
    pub spacing: f64,
    /// Standard deviation of the measured translation per axis, metres.
    pub sigma: f64,
    /// Standard deviation of the measured rotation about each axis, radians.
    pub sigma_turn: f64,
}

impl Default for LoopSettings {
    fn default() -> Self {
        Self { radius: 5.0, least_path: 40.0, spacing: 10.0, sigma: 0.03, sigma_turn: 0.0015 }
    }
}

impl LoopSettings {
    pub(crate) fn check(&self) -> Result<(), SimError> {
        let settings = [
            ("loops.radius", self.radius),
            ("loops.least_path", self.least_path),
            ("loops.spacing", self.spacing),
            ("loops.sigma", self.sigma),
            ("loops.sigma_turn", self.sigma_turn),
        ];
        let bad = settings.into_iter().find(|(_, value)| !(0.0..=1e6).contains(value));
        bad.map_or(Ok(()), |(setting, value)| Err(SimError::Setting { setting, value, allowed: "from 0 to 1000000" }))
    }
}

/// Loop edges in the order in which they close, from the older node to the newer: to the nearest earlier node within the radius that is in line of
/// sight (not behind a wall).
pub(crate) fn find(world: &World, truth: &[Pose], settings: &LoopSettings, random: &Stream) -> Vec<Edge> {
    let travelled = path_lengths(truth);
    let mut edges = Vec::new();
    let mut last = f64::NEG_INFINITY;
    for j in 0..truth.len() {
        if travelled[j] - last < settings.spacing {
            continue;
        }
        if let Some(i) = nearest_earlier(world, truth, &travelled, j, settings) {
            edges.push(loop_edge(truth, (i, j), settings, random));
            last = travelled[j];
        }
    }
    edges
}

/// The nearest node within the radius of node `j`, in line of sight, and long before it along the path.
pub(super) fn nearest_earlier(world: &World, truth: &[Pose], travelled: &[f64], j: usize, settings: &LoopSettings) -> Option<usize> {
    let pose = &truth[j];
    let old = truth.iter().enumerate().take_while(|(i, _)| travelled[j] - travelled[*i] >= settings.least_path);
    let near = old.map(|(i, p)| ((p.translation.vector - pose.translation.vector).norm(), i));
    let nearest = near.filter(|&(d, i)| d < settings.radius && is_visible(world, pose, &truth[i])).min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.map(|(_, i)| i)
}

/// The loop edge from node `i` to node `j` as it is measured.
pub(super) fn loop_edge(truth: &[Pose], (i, j): (usize, usize), settings: &LoopSettings, random: &Stream) -> Edge {
    let noise = random_motion(&mut random.fork(j as u64), settings.sigma, settings.sigma_turn);
    let (translation, rotation) = (settings.sigma.max(1e-4), settings.sigma_turn.max(1e-5));
    Edge {
        from: i as NodeId,
        to: j as NodeId,
        t_from_to: truth[i].inv_mul(&truth[j]) * noise,
        information: Some(information([translation, translation, translation, rotation, rotation, rotation])),
    }
}

fn is_visible(world: &World, from: &Pose, to: &Pose) -> bool {
    let offset = to.translation.vector - from.translation.vector;
    let Some(direction) = offset.try_normalize(1e-9) else { return true };
    world.cast(from.translation.vector.into(), direction.into(), offset.norm()).is_none()
}
