//! Viewpoints: reachable places that see a cluster of the frontier.

use crate::routes::roadmap::Roadmap;
use crate::routes::ways::Ways;
use crate::settings::ExploreSettings;
use crate::targets::clusters::FrontierCluster;
use crate::targets::gain::UnknownVolume;
use hashbrown::HashSet;
use rayon::prelude::*;
use voxelastic::query::{AtlasQuery, Ray, UnknownAs};
use voxelastic_plan::{Point, distance};

/// Clusters that are considered: the nearest ones.
const CLUSTERS: usize = 80;
/// Viewpoints whose unknown volume is computed: those at the shortest ways.
const SCORED: usize = 24;
/// Farthest a viewpoint is from the cluster that it is for, metres.
const REACH: f64 = 5.0;
/// Best distance of a viewpoint from its cluster, metres.
const BEST_DISTANCE: f64 = 1.5;
/// Places tried for a cluster.
const MOST_CANDIDATES: usize = 40;

/// A place to look from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Viewpoint {
    pub node: u32,
    pub place: Point,
    /// Length of the way there, metres.
    pub length: f64,
    /// Unknown volume that the sensor would see.
    pub volume: UnknownVolume,
}

/// The viewpoints that show at least the least volume, at the shortest ways. `is_excluded` says where not to look from.
pub(crate) fn viewpoints(
    map: &AtlasQuery<'_>,
    (roadmap, ways): (&Roadmap, &Ways),
    settings: &ExploreSettings,
    robot: Point,
    mut clusters: Vec<FrontierCluster>,
    is_excluded: impl Fn(u32) -> bool + Sync,
) -> Vec<Viewpoint> {
    clusters.sort_by(|a, b| distance(a.centre, robot).total_cmp(&distance(b.centre, robot)));
    let best = |cluster: &FrontierCluster| {
        let cost = |node: u32| ways.length(node) + 2.0 * (distance(roadmap.place(node), cluster.centre) - BEST_DISTANCE).abs();
        let mut nodes: Vec<u32> = roadmap.near(cluster.centre, REACH);
        nodes.retain(|node| ways.length(*node).is_finite() && !is_excluded(*node));
        nodes.sort_by(|a, b| cost(*a).total_cmp(&cost(*b)).then(a.cmp(b)));
        nodes.into_iter().take(MOST_CANDIDATES).find(|node| sees(map, roadmap.place(*node), cluster.centre))
    };
    // Near clusters are not always near by way, so more of them are looked at than are scored.
    let found: Vec<Option<u32>> = clusters.par_iter().take(2 * CLUSTERS).map(best).collect();
    let mut taken = HashSet::new();
    let mut nodes: Vec<u32> = found.into_iter().flatten().filter(|node| taken.insert(*node)).collect();
    nodes.sort_by(|a, b| ways.length(*a).total_cmp(&ways.length(*b)).then(a.cmp(b)));
    let score = |node: &u32| {
        let place = roadmap.place(*node);
        Viewpoint { node: *node, place, length: ways.length(*node), volume: settings.view.unknown(map, place, settings.bounds) }
    };
    // In steps, until enough of them are worth the way.
    let mut worth = Vec::new();
    for nodes in nodes.chunks(SCORED) {
        let scored: Vec<Viewpoint> = nodes.par_iter().map(score).collect();
        worth.extend(scored.into_iter().filter(|viewpoint| viewpoint.volume.possible >= settings.least_volume));
        if worth.len() >= SCORED / 3 {
            break;
        }
    }
    worth
}

/// Whether nothing is between a place and a part of the frontier.
fn sees(map: &AtlasQuery<'_>, from: Point, to: Point) -> bool {
    let length = distance(from, to);
    let end = length - 3.0 * map.voxel_size();
    end <= 0.0 || map.ray_cast(&Ray { origin: from, direction: std::array::from_fn(|k| to[k] - from[k]), length: end }, UnknownAs::Blocked).is_none()
}
