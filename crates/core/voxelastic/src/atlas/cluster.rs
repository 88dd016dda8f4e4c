//! Graph clustering (paper Sec. IV-A): which nodes share a submap, and which submaps a loop closure fuses.
//!
//! The paper fuses all submaps that hold nodes within `lambda_cluster` of a loop's ends. Taken literally, a corridor that is driven twice
//! becomes one rigid submap: every loop edge along it fuses its neighbours, the clusters overlap, and corrections inside the corridor have
//! no effect. So the size is bounded: **every node of a submap lies within `lambda_odom + lambda_cluster` of the submap's root along the
//! graph.** A fusion that would exceed the bound is refused; both submaps remain, each rigid over a distance over which drift is small.
//!
//! A refused fusion may be possible later, when another loop shortens the path; the mapper stores refusals and tries again.
//!
//! Where a place was passed often, [links of some passes](super::passes) stand for those of others, and scans of those others are connected with
//! nothing near them. Such scans do not count any more: they are in the submap, at places that scans of other passes stand for.
//!
//! Repeated traversals still fuse. A later submap covers at most `lambda_odom` of path. One of the older submaps along that part of the
//! path has its root there, so no node of the later submap is farther from that root than `lambda_odom` plus the length of the loop edge.
//! Each newer submap is fused into the older one whose root is nearest in that sense. Two consecutive submaps of one traversal, whose far
//! ends are two `lambda_odom` apart, are not fused.

use super::graph::PoseGraph;
use super::node_map::NodeMap;
use super::passes::PassRule;
use super::{NodeAssignments, SubmapId};
use crate::event::NodeId;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeSet;

/// The thresholds of clustering, metres along the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterRule {
    /// A scan goes into a submap whose root is no farther than this.
    pub lambda_odom: f64,
    /// Nodes no farther than this from either end of a loop belong to the loop's cluster.
    pub lambda_cluster: f64,
}

/// The result of clustering around a closed loop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clustered {
    /// The fusions to do, newest source first.
    pub fusions: Vec<Fusion>,
    /// Submaps that hold nodes of the cluster after these fusions, in ascending order: more than one where the size bound refuses
    /// fusions. Whether they can fuse later depends on these submaps alone, not on the loop.
    pub remaining: Vec<SubmapId>,
}

/// Two submaps to be fused, the newer one into the older one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fusion {
    /// The submap that is removed.
    pub source: SubmapId,
    /// The submap that receives its fields.
    pub target: SubmapId,
}

impl ClusterRule {
    /// Largest distance along the graph between a submap's root and any of its nodes, metres.
    pub fn bound(&self) -> f64 {
        self.lambda_odom + self.lambda_cluster
    }

    /// Largest distance along the graph, in metres, between the ends of a newly closed loop and a refused cluster that can fuse because
    /// of it: such a fusion needs a path through the new loop from a root to a node of a submap in the cluster.
    pub fn influence(&self) -> f64 {
        3.0 * self.bound() + self.lambda_cluster
    }

    /// What a place and a pass are: some places within the reach of a root, and passes longer than from one end of a submap to the other.
    pub fn passes(&self) -> PassRule {
        PassRule { place: self.bound() / 3.0, pass: 2.0 * self.bound() }
    }

    /// The fusions due to the closed loop between `ends`. Updates `assignments` to the state after these fusions.
    pub fn cluster(&self, graph: &PoseGraph, assignments: &mut NodeAssignments, ends: [NodeId; 2]) -> Clustered {
        let cluster = graph.within(&ends, self.lambda_cluster);
        let mut submaps: BTreeSet<SubmapId> = cluster.iter().filter_map(|(node, _)| assignments.submap_of(*node)).collect();
        let mut fusions = Vec::new();
        let mut reaches = Reaches { graph, bound: self.bound(), of: NodeMap::default() };
        for source in submaps.clone().into_iter().rev() {
            let target = best_target(assignments, source, submaps.range(..source), &mut reaches);
            if let Some(target) = target {
                assignments.merge(source, target);
                submaps.remove(&source);
                fusions.push(Fusion { source, target });
            }
        }
        Clustered { fusions, remaining: submaps.into_iter().collect() }
    }

    /// The submap for a scan at `node` by distance along the graph alone: `current`, the submap of its odometry predecessor, as long as
    /// that submap's root is near enough, otherwise the submap with the nearest root.
    pub fn submap_by_distance(&self, graph: &PoseGraph, assignments: &NodeAssignments, node: NodeId, current: Option<SubmapId>) -> Option<SubmapId> {
        let mut nearest = None;
        for (other, _) in graph.within(&[node], self.lambda_odom) {
            if let Some(submap) = assignments.submap_of(other).filter(|&s| assignments.root(s) == Some(other)) {
                if Some(submap) == current {
                    return current;
                }
                nearest = nearest.or(Some(submap));
            }
        }
        nearest
    }
}

/// The nodes within the bound of roots with their distances, as far as they were asked for.
struct Reaches<'a> {
    graph: &'a PoseGraph,
    bound: f64,
    of: NodeMap<NodeMap<f64>>,
}

impl Reaches<'_> {
    fn of(&mut self, root: NodeId) -> &NodeMap<f64> {
        self.of.entry(root).or_insert_with(|| self.graph.within(&[root], self.bound).into_iter().collect())
    }

    /// The distance of the farthest node of `source` from the root of `target`; none if one is out of the bound.
    fn farthest(&mut self, assignments: &mut NodeAssignments, target: SubmapId, source: SubmapId) -> Option<f64> {
        let (root, own_root) = (assignments.root(target)?, assignments.root(source)?);
        let has_retired = self.graph.has_retired();
        if let Some(node) = assignments.out_of_reach(target, source)
            && (!has_retired || self.of(own_root).contains_key(&node))
            && !self.of(root).contains_key(&node)
        {
            return None;
        }
        let nodes: Cow<'_, [NodeId]> = if has_retired {
            let connected = self.of(own_root).keys().copied().filter(|node| assignments.submap_of(*node) == Some(source));
            Cow::Owned(connected.collect())
        } else {
            Cow::Borrowed(assignments.nodes(source))
        };
        let reach = self.of(root);
        let distances: Result<Vec<f64>, NodeId> = nodes.iter().map(|node| reach.get(node).copied().ok_or(*node)).collect();
        match distances {
            Ok(distances) => Some(distances.into_iter().fold(0.0, f64::max)),
            Err(node) => {
                drop(nodes);
                assignments.set_out_of_reach(target, source, node);
                None
            }
        }
    }
}

/// The target from whose root the farthest node of `source` is nearest, if that is within the bound.
fn best_target<'a>(
    assignments: &mut NodeAssignments,
    source: SubmapId,
    targets: impl Iterator<Item = &'a SubmapId>,
    reaches: &mut Reaches<'_>,
) -> Option<SubmapId> {
    let mut best: Option<(f64, SubmapId)> = None;
    for &target in targets {
        if let Some(farthest) = reaches.farthest(assignments, target, source)
            && best.is_none_or(|(least, _)| farthest < least)
        {
            best = Some((farthest, target));
        }
    }
    best.map(|(_, target)| target)
}

#[cfg(test)]
mod tests {
    use super::super::graph::{Agreement, LinkKind};
    use super::*;
    use crate::Pose;
    use crate::event::Edge;

    const RULE: ClusterRule = ClusterRule { lambda_odom: 30.0, lambda_cluster: 15.0 };

    /// A street of `length` metres driven twice, a node every 2 m, submaps of 30 m. Nodes of the first pass are 0.., of the second 10,000..;
    /// with `back` the second pass drives in the opposite direction.
    fn street(length: f64, back: bool, offset: f64) -> (PoseGraph, NodeAssignments, Vec<NodeId>) {
        let mut graph = PoseGraph::new(Agreement { distance: 0.5, angle: 0.1 });
        let mut assignments = NodeAssignments::default();
        let count = (length / 2.0) as u64;
        let position = |pass: u64, i: u64| if pass == 1 && back { length - 2.0 * i as f64 - offset } else { 2.0 * i as f64 + pass as f64 * offset };
        for pass in 0..2u64 {
            for i in 0..count {
                let node = 10_000 * pass + i;
                graph.add_node(node, &Pose::translation(position(pass, i), pass as f64, 0.0));
                if i > 0 {
                    graph.assume_odometry(node - 1, node);
                }
                assignments.add(node, (pass * 1000 + i / 15) as SubmapId);
            }
        }
        let second = (0..count).map(|i| 10_000 + i).collect();
        (graph, assignments, second)
    }

    fn close_loops(graph: &mut PoseGraph, assignments: &mut NodeAssignments, length: f64, step: usize, second: &[NodeId]) -> Vec<Fusion> {
        let mut done = Vec::new();
        for &node in second.iter().step_by(step) {
            let here = *graph.pose(node).unwrap();
            let nearest = (0..(length / 2.0) as u64)
                .min_by(|a, b| {
                    let d = |n: &u64| (graph.pose(*n).unwrap().translation.vector - here.translation.vector).norm();
                    d(a).total_cmp(&d(b))
                })
                .unwrap();
            let t_from_to = graph.pose(nearest).unwrap().inv_mul(&here);
            graph.add_edge(LinkKind::Loop, &Edge { from: nearest, to: node, t_from_to, information: None }).unwrap();
            for ends in graph.take_closed() {
                done.extend(RULE.cluster(graph, assignments, ends).fusions);
            }
        }
        done
    }

    #[test]
    fn a_street_driven_twice_keeps_several_submaps_and_the_second_pass_adds_none() {
        for back in [false, true] {
            for offset in [0.0, 7.0, 16.0] {
                let (mut graph, mut assignments, second) = street(300.0, back, offset);
                let before = assignments.submaps().count();
                let fusions = close_loops(&mut graph, &mut assignments, 300.0, 5, &second);
                let after: Vec<SubmapId> = assignments.submaps().collect();
                assert!((9..=12).contains(&after.len()), "back {back}, offset {offset}: {} of {before} left", after.len());
                assert!(fusions.iter().all(|f| f.target < f.source));
                for submap in after {
                    let root = assignments.root(submap).unwrap();
                    let reach: NodeMap<f64> = graph.within(&[root], RULE.bound()).into_iter().collect();
                    assert!(assignments.nodes(submap).iter().all(|n| reach.contains_key(n)), "bound of submap {submap}");
                }
            }
        }
    }

    /// A robot that goes to and fro on 60 m, `passes` times, a node every 2 m, `offset` to the side, with nodes from `first` on in the submaps of its first pass: two of
    /// 30 m from `submap` on. Every 10 m it finds itself at the node of the first pass.
    fn to_and_fro(graph: &mut PoseGraph, assignments: &mut NodeAssignments, [first, passes]: [u64; 2], submap: SubmapId, offset: f64) -> NodeId {
        let place = |k: u64| if (k / 30).is_multiple_of(2) { k % 30 } else { 29 - k % 30 };
        for k in 0..30 * passes {
            let (node, at) = (first + k, place(k));
            graph.add_node(node, &Pose::translation(2.0 * at as f64, offset + 0.01 * (k / 30) as f64, 0.0));
            if k > 0 {
                graph.assume_odometry(node - 1, node);
            }
            if k >= 30 && at % 5 == 0 {
                let t_from_to = graph.pose(first + at).unwrap().inv_mul(graph.pose(node).unwrap());
                graph.add_edge(LinkKind::Overlap, &Edge { from: first + at, to: node, t_from_to, information: None }).unwrap();
            }
            assignments.add(node, submap + (at / 15) as SubmapId);
        }
        graph.take_closed();
        first + 30 * passes - 1
    }

    #[test]
    fn submaps_of_many_passes_can_be_fused() {
        let fused = |passes: u64| {
            let mut graph = PoseGraph::new(Agreement { distance: 0.5, angle: 0.1 }).with_passes(RULE.passes());
            let mut assignments = NodeAssignments::default();
            to_and_fro(&mut graph, &mut assignments, [0, passes], 0, 0.0);
            to_and_fro(&mut graph, &mut assignments, [10_000, passes], 7, 1.0);
            assert_eq!(graph.has_retired(), passes > 10);
            let mut fusions = Vec::new();
            for at in [0, 15] {
                let t_from_to = graph.pose(at).unwrap().inv_mul(graph.pose(10_000 + at).unwrap());
                graph.add_edge(LinkKind::Loop, &Edge { from: at, to: 10_000 + at, t_from_to, information: None }).unwrap();
                for ends in graph.take_closed() {
                    fusions.extend(RULE.cluster(&graph, &mut assignments, ends).fusions);
                }
            }
            fusions
        };
        assert_eq!(fused(1), [Fusion { source: 7, target: 0 }, Fusion { source: 8, target: 1 }]);
        // Links that are not followed make ways longer, so that a fusion may be refused that just kept the bound.
        assert_eq!(fused(40), [Fusion { source: 7, target: 0 }]);
    }

    #[test]
    fn a_scan_stays_in_the_current_submap_while_its_root_is_near_else_takes_the_nearest_root() {
        let (mut graph, mut assignments, _) = street(60.0, false, 0.0);
        assert_eq!(RULE.submap_by_distance(&graph, &assignments, 14, Some(0)), Some(0));
        assert_eq!(RULE.submap_by_distance(&graph, &assignments, 10_020, Some(1001)), Some(1001));
        let mut far = Pose::translation(30.0, 1.0, 0.0);
        graph.add_node(99_999, &far);
        assert_eq!(RULE.submap_by_distance(&graph, &assignments, 99_999, None), None, "not connected");
        far = graph.pose(15).unwrap().inv_mul(&far);
        graph.add_edge(LinkKind::Loop, &Edge { from: 15, to: 99_999, t_from_to: far, information: None }).unwrap();
        assert_eq!(RULE.submap_by_distance(&graph, &assignments, 99_999, None), Some(1), "a closed loop leads to submap 1's root");
        assignments.merge(1, 0);
        assert_eq!(RULE.submap_by_distance(&graph, &assignments, 99_999, None), None, "31 m from the root of submap 0");
    }
}
