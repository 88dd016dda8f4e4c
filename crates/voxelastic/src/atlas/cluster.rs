//! Graph clustering (paper Sec. IV-A): which nodes share a submap, and which submaps a loop closure fuses.
//!
//! The paper fuses all submaps that hold nodes within `lambda_cluster` of a loop's ends. Taken literally, a corridor that is driven twice
//! ends as one rigid submap: every loop edge along it fuses its neighbours, the clusters overlap, and nothing is left to bend. So there
//! is a bound: **every node of a submap lies within `lambda_odom + lambda_cluster` of the submap's root along the graph.** A fusion that
//! would break it is not done; the submaps stay apart, each rigid over a stretch that drift over that distance can describe.
//!
//! What the bound keeps apart now may fit later, when another loop shortens the way; the mapper asks again then.
//!
//! Traversals still fuse. A later submap covers at most `lambda_odom` of path; of the older submaps beside it, one has its root beside
//! that stretch, and then no node of the later one is farther from it than `lambda_odom` and the loop edge's own length. Each newer
//! submap goes into the older one whose root is nearest in that sense, and two neighbours of the same traversal, whose far ends are two
//! `lambda_odom` apart, stay two.

use super::graph::PoseGraph;
use super::{Members, SubmapId};
use crate::event::NodeId;
use std::collections::{BTreeSet, HashMap};

/// The thresholds of clustering, metres along the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClusterRule {
    /// A scan goes into a submap whose root is no farther than this.
    pub lambda_odom: f64,
    /// Nodes no farther than this from either end of a loop belong to the loop's cluster.
    pub lambda_cluster: f64,
}

/// What a closed loop leads to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clustered {
    /// The fusions that it asks for, newest source first.
    pub fusions: Vec<Fusion>,
    /// Submaps that its cluster is in after them, in ascending order: more than one where the bound keeps some apart. Whether they can
    /// fuse later is a matter of these submaps alone, whatever loop asks.
    pub left: Vec<SubmapId>,
}

/// A submap that is to become part of an older one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fusion {
    /// The submap that goes.
    pub source: SubmapId,
    /// The submap that stays.
    pub target: SubmapId,
}

impl ClusterRule {
    /// Largest distance along the graph between a submap's root and any of its nodes, metres.
    pub fn bound(&self) -> f64 {
        self.lambda_odom + self.lambda_cluster
    }

    /// Farthest along the graph from the ends of a loop that has just closed that another loop's cluster can be if it is to fuse now and
    /// was not to before: such a fusion needs a way through the new loop from a root to a node, and the cluster is with the node's submap.
    pub fn influence(&self) -> f64 {
        3.0 * self.bound() + self.lambda_cluster
    }

    /// What the closed loop between `ends` asks for. `members` is left as it will be after the fusions.
    pub fn cluster(&self, graph: &PoseGraph, members: &mut Members, ends: [NodeId; 2]) -> Clustered {
        let cluster = graph.within(&ends, self.lambda_cluster);
        let mut submaps: BTreeSet<SubmapId> = cluster.iter().filter_map(|(node, _)| members.submap_of(*node)).collect();
        let mut fusions = Vec::new();
        let mut reaches: HashMap<SubmapId, HashMap<NodeId, f64>> = HashMap::new();
        for source in submaps.clone().into_iter().rev() {
            let target = self.best_target(graph, members, source, submaps.range(..source), &mut reaches);
            if let Some(target) = target {
                members.merge(source, target);
                submaps.remove(&source);
                fusions.push(Fusion { source, target });
            }
        }
        Clustered { fusions, left: submaps.into_iter().collect() }
    }

    /// The target from whose root the farthest node of `source` is nearest, if that is within the bound.
    fn best_target<'a>(
        &self,
        graph: &PoseGraph,
        members: &Members,
        source: SubmapId,
        targets: impl Iterator<Item = &'a SubmapId>,
        reaches: &mut HashMap<SubmapId, HashMap<NodeId, f64>>,
    ) -> Option<SubmapId> {
        let mut best: Option<(f64, SubmapId)> = None;
        for &target in targets {
            let Some(root) = members.root(target) else { continue };
            let reach = reaches.entry(target).or_insert_with(|| graph.within(&[root], self.bound()).into_iter().collect());
            let farthest = members.nodes(source).iter().try_fold(0.0f64, |far, node| reach.get(node).map(|d| far.max(*d)));
            if let Some(farthest) = farthest
                && best.is_none_or(|(least, _)| farthest < least)
            {
                best = Some((farthest, target));
            }
        }
        best.map(|(_, target)| target)
    }

    /// The submap that a scan at `node` belongs to by distance alone: `home`, where its odometry comes from, while it is near enough to
    /// that submap's root, else the submap with the nearest root.
    pub fn submap_by_distance(&self, graph: &PoseGraph, members: &Members, node: NodeId, home: Option<SubmapId>) -> Option<SubmapId> {
        let mut nearest = None;
        for (other, _) in graph.within(&[node], self.lambda_odom) {
            if let Some(submap) = members.submap_of(other).filter(|&s| members.root(s) == Some(other)) {
                if Some(submap) == home {
                    return home;
                }
                nearest = nearest.or(Some(submap));
            }
        }
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::super::graph::{Agreement, LinkKind};
    use super::*;
    use crate::Pose;
    use crate::event::Edge;

    const RULE: ClusterRule = ClusterRule { lambda_odom: 30.0, lambda_cluster: 15.0 };

    /// A street of `length` metres driven twice, 2 m a node, in submaps of 30 m; nodes 0.. forth, 10,000.. again, `back` on the way back.
    fn street(length: f64, back: bool, offset: f64) -> (PoseGraph, Members, Vec<NodeId>) {
        let mut graph = PoseGraph::new(Agreement { distance: 0.5, angle: 0.1 });
        let mut members = Members::default();
        let count = (length / 2.0) as u64;
        let position = |pass: u64, i: u64| if pass == 1 && back { length - 2.0 * i as f64 - offset } else { 2.0 * i as f64 + pass as f64 * offset };
        for pass in 0..2u64 {
            for i in 0..count {
                let node = 10_000 * pass + i;
                graph.add_node(node, &Pose::translation(position(pass, i), pass as f64, 0.0));
                if i > 0 {
                    graph.assume_odometry(node - 1, node);
                }
                members.add(node, (pass * 1000 + i / 15) as SubmapId);
            }
        }
        let second = (0..count).map(|i| 10_000 + i).collect();
        (graph, members, second)
    }

    fn close_loops(graph: &mut PoseGraph, members: &mut Members, length: f64, every: usize, second: &[NodeId]) -> Vec<Fusion> {
        let mut done = Vec::new();
        for &node in second.iter().step_by(every) {
            let here = *graph.pose(node).unwrap();
            let partner = (0..(length / 2.0) as u64)
                .min_by(|a, b| {
                    let d = |n: &u64| (graph.pose(*n).unwrap().translation.vector - here.translation.vector).norm();
                    d(a).total_cmp(&d(b))
                })
                .unwrap();
            let t_from_to = graph.pose(partner).unwrap().inv_mul(&here);
            graph.add_edge(LinkKind::Loop, &Edge { from: partner, to: node, t_from_to, information: None }).unwrap();
            for ends in graph.take_closed() {
                done.extend(RULE.cluster(graph, members, ends).fusions);
            }
        }
        done
    }

    #[test]
    fn a_street_driven_twice_is_not_welded_and_its_second_drive_is_absorbed() {
        for back in [false, true] {
            for offset in [0.0, 7.0, 16.0] {
                let (mut graph, mut members, second) = street(300.0, back, offset);
                let before = members.submaps().count();
                let fusions = close_loops(&mut graph, &mut members, 300.0, 5, &second);
                let after: Vec<SubmapId> = members.submaps().collect();
                assert!((9..=12).contains(&after.len()), "back {back}, offset {offset}: {} of {before} left", after.len());
                assert!(fusions.iter().all(|f| f.target < f.source));
                for submap in after {
                    let root = members.root(submap).unwrap();
                    let reach: HashMap<NodeId, f64> = graph.within(&[root], RULE.bound()).into_iter().collect();
                    assert!(members.nodes(submap).iter().all(|n| reach.contains_key(n)), "bound of submap {submap}");
                }
            }
        }
    }

    #[test]
    fn a_scan_stays_at_home_then_goes_where_the_root_is_near() {
        let (mut graph, mut members, _) = street(60.0, false, 0.0);
        assert_eq!(RULE.submap_by_distance(&graph, &members, 14, Some(0)), Some(0));
        assert_eq!(RULE.submap_by_distance(&graph, &members, 10_020, Some(1001)), Some(1001));
        let mut far = Pose::translation(30.0, 1.0, 0.0);
        graph.add_node(99_999, &far);
        assert_eq!(RULE.submap_by_distance(&graph, &members, 99_999, None), None, "not connected");
        far = graph.pose(15).unwrap().inv_mul(&far);
        graph.add_edge(LinkKind::Loop, &Edge { from: 15, to: 99_999, t_from_to: far, information: None }).unwrap();
        assert_eq!(RULE.submap_by_distance(&graph, &members, 99_999, None), Some(1), "a closed loop leads to submap 1's root");
        members.merge(1, 0);
        assert_eq!(RULE.submap_by_distance(&graph, &members, 99_999, None), None, "31 m from the root of submap 0");
    }
}
