//! Which submap a scan goes into (paper Sec. IV-A, IV-B).
//!
//! By distance along the graph, if that leads to a submap; else by what the scan would add to the submaps around it; else a new submap
//! begins with it. The second step makes the number of submaps level off once space is explored, also where the SLAM system has good
//! poses but draws no loop edge: a place that an older submap describes well needs no second description.

use super::{Front, Mapper, Placed};
use crate::atlas::SubmapId;
use crate::atlas::graph::LinkKind;
use crate::atlas::overlap::{Probe, overlap};
use crate::event::{Edge, NodeId, Scan};
use crate::geometry::{Pose, PoseExt, Rigid};
use std::collections::HashSet;

/// Most submaps that a scan is held against.
const CANDIDATES: usize = 4;

/// A submap that may know what a scan sees.
struct Candidate {
    submap: SubmapId,
    /// The submap's node that the scan's node would be linked to.
    node: NodeId,
    /// Distance along the graph from the submap's root to the scan's node over that link, metres.
    distance: f64,
}

impl Mapper {
    /// The submap for `scan`, whose node is one of the graph already and which `front` prepared last.
    pub(super) fn assign(&mut self, scan: &Scan, front: &mut Front) -> (SubmapId, Placed) {
        let Scan { node, t_map_lidar, .. } = scan;
        let node = *node;
        let home = self.graph.odometry_neighbours(node).find_map(|n| self.members.submap_of(n));
        if let Some(id) = self.rule.submap_by_distance(&self.graph, &self.members, node, home) {
            return (id, if home == Some(id) { Placed::Onward } else { Placed::Revisit });
        }
        if let Some(found) = self.submap_by_overlap(scan, front) {
            if let Some(t_map_from) = self.graph.pose(found.node) {
                let edge = Edge { from: found.node, to: node, t_from_to: t_map_from.inv_mul(t_map_lidar), information: None };
                // Both nodes are known and different, and the pose is rigid: nothing here can be refused.
                let _ = self.graph.add_edge(LinkKind::Overlap, &edge);
            }
            return (found.submap, Placed::Overlap);
        }
        (self.atlas.spawn(*t_map_lidar), Placed::NewSubmap)
    }

    /// The submap nearby that knows most of the scan, if that is enough.
    ///
    /// Only a return counts: neighbours along the path see much the same, and that alone would stretch every submap to its bound. So the
    /// submap must have been here before, with a node that is near in space and far along the odometry.
    fn submap_by_overlap(&self, scan: &Scan, front: &mut Front) -> Option<Candidate> {
        let Scan { node, t_map_lidar, cloud, .. } = scan;
        let least = self.settings.min_overlap;
        if least >= 1.0 {
            return None;
        }
        let along: HashSet<NodeId> = self.graph.within_pass(*node, self.rule.bound()).into_iter().map(|(other, _)| other).collect();
        let mut candidates: Vec<Candidate> = self.members.submaps().filter_map(|id| self.candidate(id, t_map_lidar, &along)).collect();
        candidates.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.submap.cmp(&b.submap)));
        candidates.truncate(CANDIDATES);
        if !candidates.is_empty() {
            front.fit_planes(cloud);
        }
        let beams = &front.scan().beams;
        let probe = Probe { points: &beams.points, normals: &beams.normals, voxel: self.settings.voxel };
        let known = candidates.into_iter().filter_map(|candidate| {
            let submap = self.atlas.submap(candidate.submap)?;
            let root = self.graph.pose(self.members.root(candidate.submap)?)?;
            let share = overlap(submap, &Rigid::from(&root.inv_mul(t_map_lidar)), &probe).worst_direction;
            (share >= least).then_some((share, candidate))
        });
        known.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.submap.cmp(&a.1.submap))).map(|(_, candidate)| candidate)
    }

    /// How a scan at `t_map_lidar` could be linked to a submap, other than to the nodes `along` its way, without breaking the bound on
    /// the submap's size.
    fn candidate(&self, id: SubmapId, t_map_lidar: &Pose, along: &HashSet<NodeId>) -> Option<Candidate> {
        let root = self.members.root(id)?;
        let (bound, reach) = (self.rule.bound(), self.rule.lambda_cluster);
        if self.graph.pose(root)?.translation_distance(t_map_lidar) > bound {
            return None;
        }
        let nodes = self.graph.within(&[root], bound);
        let links =
            nodes.iter().filter(|(node, _)| self.members.submap_of(*node) == Some(id) && !along.contains(node)).filter_map(|&(node, from_root)| {
                let gap = self.graph.pose(node)?.translation_distance(t_map_lidar);
                (gap <= reach && from_root + gap <= bound).then_some(Candidate { submap: id, node, distance: from_root + gap })
            });
        links.min_by(|a, b| a.distance.total_cmp(&b.distance).then(a.node.cmp(&b.node)))
    }
}
