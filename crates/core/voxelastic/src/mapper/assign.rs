//! Choice of the submap of a scan (paper Sec. IV-A, IV-B).
//!
//! First by distance along the graph. If no submap is near enough, by overlap of the scan with the submaps around it. Otherwise the scan
//! starts a new submap. The second step bounds the number of submaps once space is explored, also where the SLAM system has good poses but
//! adds no loop edge: a place that an older submap contains needs no second submap.

use super::clusters::Clusters;
use super::frontend::FrontendScan;
use super::report::Assignment;
use crate::atlas::graph::LinkKind;
use crate::atlas::overlap::{OverlapQuery, overlap};
use crate::atlas::{Atlas, NodeSet, SubmapId, ends_lap, laps};
use crate::event::{Edge, NodeId, Scan};
use crate::geometry::{Pose, PoseExt, Rigid};

/// Largest number of submaps with which a scan is compared.
const MAX_CANDIDATES: usize = 4;

/// A submap that may contain a scan.
struct Candidate {
    submap: SubmapId,
    /// The submap's node to which the scan's node would be linked.
    node: NodeId,
    /// Distance along the graph from the submap's root to the scan's node over that link, metres.
    distance: f64,
}

/// The submap for `scan`: its node is in the graph already, and `prepared` is the scan after preprocessing. `min_overlap` is the share of the scan that a
/// submap has to contain, 1 or more to assign by distance only. May add a submap and a link.
pub(super) fn assign(
    clusters: &mut Clusters,
    atlas: &mut Atlas,
    scan: &Scan,
    prepared: &mut FrontendScan<'_>,
    min_overlap: f64,
) -> (SubmapId, Assignment) {
    let Scan { node, t_map_lidar, .. } = scan;
    let node = *node;
    let current = clusters.graph.odometry_neighbours(node).find_map(|n| clusters.assignments.submap_of(n));
    if let Some(id) = clusters.rule.submap_by_distance(&clusters.graph, &clusters.assignments, node, current) {
        return (id, if current == Some(id) { Assignment::Continue } else { Assignment::Revisit });
    }
    if min_overlap < 1.0
        && let Some(found) = submap_by_overlap(clusters, atlas, scan, prepared, min_overlap)
    {
        if let Some(t_map_from) = clusters.graph.pose(found.node) {
            let edge = Edge { from: found.node, to: node, t_from_to: t_map_from.inv_mul(t_map_lidar), information: None };
            // Both nodes are in the graph and different, and the pose is rigid: the edge cannot be refused.
            let _ = clusters.graph.add_edge(LinkKind::Overlap, &edge);
        }
        return (found.submap, Assignment::Overlap);
    }
    (atlas.spawn(*t_map_lidar), Assignment::NewSubmap)
}

/// The submap for `scan`, its node in the graph already, where laps are kept apart: the one that the last scan went into, as long as its root is near and the scan does
/// not end the lap that began with submap `lap`. May add a submap, and begin a lap with it.
pub(super) fn assign_within_lap(clusters: &Clusters, atlas: &mut Atlas, scan: &Scan, lap: &mut Option<SubmapId>) -> (SubmapId, Assignment) {
    let current = clusters.graph.odometry_neighbours(scan.node).find_map(|n| clusters.assignments.submap_of(n));
    let first = *lap.get_or_insert_with(|| {
        let laps = laps(atlas.submaps());
        let last = laps.values().last().copied();
        laps.into_iter().find(|(_, lap)| Some(*lap) == last).map_or(0, |(id, _)| id)
    });
    let ends_lap = ends_lap(atlas.submaps(), first, &scan.t_map_lidar);
    let is_near = || clusters.rule.submap_by_distance(&clusters.graph, &clusters.assignments, scan.node, current) == current;
    match current {
        Some(id) if !ends_lap && is_near() => (id, Assignment::Continue),
        _ => {
            let id = atlas.spawn(scan.t_map_lidar);
            if ends_lap {
                *lap = Some(id);
            }
            (id, Assignment::NewSubmap)
        }
    }
}

/// The submap nearby that contains the largest share of the scan, if that is at least `min_overlap`.
///
/// Only returns to a place count: neighbours along the path overlap anyway, and assigning by that would extend every submap to its size
/// bound. So the submap must have a node that is near in space and far along the odometry.
fn submap_by_overlap(clusters: &Clusters, atlas: &Atlas, scan: &Scan, prepared: &mut FrontendScan<'_>, min_overlap: f64) -> Option<Candidate> {
    let Scan { node, t_map_lidar, .. } = scan;
    let Clusters { rule, graph, assignments, .. } = clusters;
    let same_pass: NodeSet = graph.within_pass(*node, rule.bound()).into_iter().map(|(other, _)| other).collect();
    let mut candidates: Vec<Candidate> = assignments.submaps().filter_map(|id| candidate(clusters, id, t_map_lidar, &same_pass)).collect();
    candidates.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.submap.cmp(&b.submap)));
    candidates.truncate(MAX_CANDIDATES);
    if !candidates.is_empty() {
        prepared.fit_planes();
    }
    let returns = &prepared.scan().returns;
    let query = OverlapQuery { points: &returns.points, normals: &returns.normals };
    let overlapping = candidates.into_iter().filter_map(|candidate| {
        let submap = atlas.submap(candidate.submap)?;
        let root = graph.pose(assignments.root(candidate.submap)?)?;
        let share = overlap(submap, &Rigid::from(&root.inv_mul(t_map_lidar)), &query).worst_direction;
        (share >= min_overlap).then_some((share, candidate))
    });
    overlapping.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.submap.cmp(&a.1.submap))).map(|(_, candidate)| candidate)
}

/// The shortest link from a scan at `t_map_lidar` to a node of submap `id` that is not of the `same_pass`, within the size bound.
fn candidate(clusters: &Clusters, id: SubmapId, t_map_lidar: &Pose, same_pass: &NodeSet) -> Option<Candidate> {
    let Clusters { rule, graph, assignments, .. } = clusters;
    let root = assignments.root(id)?;
    let (bound, max_gap) = (rule.bound(), rule.lambda_cluster);
    if graph.pose(root)?.translation_distance(t_map_lidar) > bound {
        return None;
    }
    let nodes = graph.within(&[root], bound);
    let links = nodes.iter().filter(|(node, _)| assignments.submap_of(*node) == Some(id) && !same_pass.contains(node));
    let links = links.filter_map(|&(node, from_root)| {
        let gap = graph.pose(node)?.translation_distance(t_map_lidar);
        (gap <= max_gap && from_root + gap <= bound).then_some(Candidate { submap: id, node, distance: from_root + gap })
    });
    links.min_by(|a, b| a.distance.total_cmp(&b.distance).then(a.node.cmp(&b.node)))
}
