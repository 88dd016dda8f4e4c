//! Tests of the pose graph.

use super::super::passes::{FIRST, LAST, PassRule};
use super::*;
use nalgebra::Vector3;
use proptest::prelude::*;
use std::collections::BTreeSet;

const AGREEMENT: Agreement = Agreement { distance: 0.2, angle: 0.05 };

fn at(x: f64) -> Pose {
    Pose::translation(x, 0.0, 0.0)
}

fn edge(from: NodeId, to: NodeId, length: f64) -> Edge {
    Edge { from, to, t_from_to: at(length), information: None }
}

#[test]
fn edges_may_precede_their_nodes_and_odometry_replaces_assumed_links() {
    let mut graph = PoseGraph::new(AGREEMENT);
    assert_eq!(graph.add_edge(LinkKind::Odometry, &edge(0, 1, 2.0)), Ok(EdgeOutcome::Waiting));
    assert_eq!(graph.add_edge(LinkKind::Loop, &edge(2, 0, -5.0)), Ok(EdgeOutcome::Waiting));
    assert_eq!(graph.next_node(), 3);
    graph.add_node(0, &at(0.0));
    graph.add_node(1, &at(2.5));
    graph.assume_odometry(0, 1);
    assert_eq!(graph.within(&[0], 10.0), [(0, 0.0), (1, 2.0)], "the measured edge is used");
    graph.add_node(2, &at(5.0));
    graph.assume_odometry(1, 2);
    assert_eq!(graph.take_closed(), [[2, 0]], "the loop closes when its second node is added");
    assert_eq!(graph.within(&[0], 10.0), [(0, 0.0), (1, 2.0), (2, 4.5)]);
    assert_eq!(graph.add_edge(LinkKind::Odometry, &edge(1, 2, 2.0)), Ok(EdgeOutcome::Added));
    assert_eq!(graph.within(&[0], 10.0), [(0, 0.0), (1, 2.0), (2, 4.0)]);
    assert_eq!(graph.add_edge(LinkKind::Odometry, &edge(1, 2, 1.0)), Ok(EdgeOutcome::Replaced));
    let expected = GraphCounts { nodes: 3, odometry_edges: 2, loop_edges: 1, ..GraphCounts::default() };
    assert_eq!(graph.counts(), expected);
}

#[test]
fn a_loop_opens_and_closes_with_the_poses() {
    let mut graph = PoseGraph::new(AGREEMENT);
    (0..3).for_each(|i| graph.add_node(i, &at(10.0 * i as f64)));
    assert_eq!(graph.add_edge(LinkKind::Loop, &edge(0, 2, 0.1)), Ok(EdgeOutcome::Added));
    assert!(graph.take_closed().is_empty() && graph.within(&[0], 5.0).len() == 1, "off by 20 m");
    assert_eq!(graph.update_poses(&[(2, at(0.2)), (77, at(0.0))]), 1);
    graph.refresh_loops();
    assert_eq!((graph.take_closed(), graph.within(&[0], 5.0)), (vec![[0, 2]], vec![(0, 0.0), (2, 0.1)]));
    assert_eq!(graph.within_pass(0, 5.0), [(0, 0.0)], "a loop is another pass");
    graph.update_poses(&[(2, at(0.5))]);
    graph.refresh_loops();
    assert!(graph.within(&[0], 5.0).len() == 1 && graph.counts().open_loops == 1);
}

#[test]
fn invalid_edges_are_refused_and_unknown_starts_are_ignored() {
    let mut graph = PoseGraph::new(AGREEMENT);
    graph.add_node(3, &at(0.0));
    assert_eq!(graph.add_edge(LinkKind::Loop, &edge(3, 3, 0.0)), Err(EdgeError::SelfEdge { node: 3 }));
    assert_eq!(graph.add_edge(LinkKind::Loop, &edge(3, 4, f64::NAN)), Err(EdgeError::BadEdge { from: 3, to: 4 }));
    assert!(graph.within(&[9], 100.0).is_empty() && graph.counts().waiting_edges == 0);
}

proptest! {
    #[test]
    fn distances_equal_floyd_warshall(links in prop::collection::vec((0u64..12, 0u64..12, 0.0f64..5.0), 0..30), limit in 0.0f64..15.0) {
        let mut graph = PoseGraph::new(AGREEMENT);
        (0..12).for_each(|i| graph.add_node(i, &at(0.0)));
        let mut slow = [[f64::INFINITY; 12]; 12];
        (0..12).for_each(|i| slow[i][i] = 0.0);
        for &(a, b, length) in links.iter().filter(|(a, b, _)| a != b) {
            let t = Pose::from(Vector3::new(length, 0.0, 0.0));
            if graph.add_edge(LinkKind::Odometry, &Edge { from: a, to: b, t_from_to: t, information: None }) == Ok(EdgeOutcome::Added) {
                for (i, j) in [(a, b), (b, a)] {
                    slow[i as usize][j as usize] = length;
                }
            } else {
                for (i, j) in [(a, b), (b, a)] {
                    slow[i as usize][j as usize] = length; // a repeated edge replaces the first
                }
            }
        }
        for k in 0..12 {
            for i in 0..12 {
                for j in 0..12 {
                    slow[i][j] = slow[i][j].min(slow[i][k] + slow[k][j]);
                }
            }
        }
        let reached = graph.within(&[4], limit);
        prop_assert!(reached.windows(2).all(|w| w[0].1 <= w[1].1));
        for j in 0..12u64 {
            let fast = reached.iter().find(|r| r.0 == j).map(|r| r.1);
            let exact = slow[4][j as usize];
            if (exact - limit).abs() > 1e-9 {
                prop_assert_eq!(fast.is_some(), exact <= limit);
                prop_assert!(fast.is_none_or(|d| (d - exact).abs() < 1e-9));
            }
        }
    }
}

/// A robot that goes round a circle with 8 places, 2 m apart, and in each round finds itself at some of them in an earlier round.
struct Rounds {
    graph: PoseGraph,
    nodes: usize,
    /// Older node, newer node, and how much further apart they seem.
    links: Vec<(usize, usize, f64)>,
}

const PLACES: usize = 8;
const STEP: f64 = 2.0;

impl Rounds {
    fn position(node: usize) -> Vector3<f64> {
        let angle = node as f64 * std::f64::consts::TAU / PLACES as f64;
        let radius = STEP / (2.0 * (std::f64::consts::PI / PLACES as f64).sin());
        // Each round at its own height, so that no two ways are as long as each other.
        Vector3::new(radius * angle.cos() + 100.0, radius * angle.sin() + 100.0, 0.5 + 0.003 * (node / PLACES) as f64)
    }

    /// The node of each place is linked with one of an earlier round where `links` says how many rounds before.
    fn drive(links: &[Option<usize>], rule: Option<PassRule>) -> Self {
        let mut graph = PoseGraph::new(AGREEMENT);
        if let Some(rule) = rule {
            graph = graph.with_passes(rule);
        }
        let mut made = Vec::new();
        for (node, before) in links.iter().enumerate() {
            graph.add_node(node as NodeId, &Pose::from(Self::position(node)));
            if node > 0 {
                graph.assume_odometry(node as NodeId - 1, node as NodeId);
            }
            if let Some(older) = before.and_then(|rounds| node.checked_sub(PLACES * (1 + rounds % 8))) {
                let t_from_to = Pose::from(Self::position(node) - Self::position(older));
                let edge = Edge { from: older as NodeId, to: node as NodeId, t_from_to, information: None };
                graph.add_edge(LinkKind::Overlap, &edge).unwrap();
                made.push((older, node, t_from_to.translation.vector.norm()));
            }
        }
        Self { graph, nodes: links.len(), links: made }
    }

    /// The links of the first and of the last passes of each place.
    fn kept(&self, rule: PassRule) -> Vec<(usize, usize, f64)> {
        let pass = |node: usize| ((0..node).map(|k| (Self::position(k + 1) - Self::position(k)).norm()).sum::<f64>() / rule.pass) as u64;
        let place = |node: usize| Self::position(node).map(|c| (c / rule.place).floor() as i64);
        let is_kept = |&&(older, newer, _): &&(usize, usize, f64)| {
            let here = self.links.iter().filter(|other| place(other.0) == place(older));
            let passes: BTreeSet<u64> = here.map(|other| pass(other.1)).collect();
            let before = passes.iter().filter(|other| **other < pass(newer)).count();
            before < FIRST || passes.len() - before <= LAST
        };
        self.links.iter().filter(is_kept).copied().collect()
    }

    /// Distances between all nodes by Floyd and Warshall over odometry and `links`.
    fn distances(&self, links: &[(usize, usize, f64)]) -> Vec<Vec<f64>> {
        let n = self.nodes;
        let mut slow = vec![vec![f64::INFINITY; n]; n];
        let odometry = (1..n).map(|k| (k - 1, k, (Self::position(k) - Self::position(k - 1)).norm()));
        (0..n).for_each(|k| slow[k][k] = 0.0);
        for (a, b, length) in odometry.chain(links.iter().copied()) {
            slow[a][b] = slow[a][b].min(length);
            slow[b][a] = slow[a][b];
        }
        for k in 0..n {
            for i in 0..n {
                for j in 0..n {
                    slow[i][j] = slow[i][j].min(slow[i][k] + slow[k][j]);
                }
            }
        }
        slow
    }
}

const PASSES: PassRule = PassRule { place: 2.5, pass: 17.0 };

proptest! {
    #[test]
    fn distances_are_those_over_the_links_of_the_first_and_last_passes(links in prop::collection::vec(prop::option::of(0usize..8), 1..90)) {
        let (rounds, all) = (Rounds::drive(&links, Some(PASSES)), Rounds::drive(&links, None));
        let kept = rounds.kept(PASSES);
        let (slow, shortest) = (rounds.distances(&kept), rounds.distances(&rounds.links));
        for start in [0, rounds.nodes / 2, rounds.nodes - 1] {
            let reached: HashMap<NodeId, f64> = rounds.graph.within(&[start as NodeId], 12.0).into_iter().collect();
            for node in 0..rounds.nodes {
                let (fast, exact) = (reached.get(&(node as NodeId)), slow[start][node]);
                prop_assert!(exact >= shortest[start][node]);
                if (exact - 12.0).abs() > 1e-9 {
                    prop_assert_eq!(fast.is_some(), exact < 12.0, "from {} to {}: {}", start, node, exact);
                    prop_assert!(fast.is_none_or(|fast| (fast - exact).abs() < 1e-9));
                }
            }
        }
        // What is counted are all links.
        let (counts, expected) = (rounds.graph.counts(), all.graph.counts());
        prop_assert_eq!(counts.retired_links, rounds.links.len() - kept.len());
        prop_assert_eq!(GraphCounts { retired_links: 0, ..counts }, expected);
        prop_assert_eq!(rounds.graph.has_retired(), counts.retired_links > 0);
    }
}

#[test]
fn a_search_looks_at_no_more_nodes_in_the_thousandth_round_than_in_the_tenth() {
    let links = |rounds: usize| (0..rounds * PLACES).map(|node| Some(node / 3)).collect::<Vec<_>>();
    let reached = |rounds: usize| {
        let rounds = Rounds::drive(&links(rounds), Some(PASSES));
        let current = rounds.nodes as NodeId - 1;
        [0, current].map(|start| rounds.graph.within(&[start], 12.0).len())
    };
    let [tenth, thousandth] = [10, 1000].map(reached);
    assert!(thousandth.iter().zip(tenth).all(|(later, early)| *later <= 2 * early), "{tenth:?}, {thousandth:?}");
    let all = Rounds::drive(&links(1000), None).graph.within(&[0], 12.0).len();
    assert!(all > 20 * thousandth[0], "{all} of all passes");
}

#[test]
fn loops_that_close_late_or_again_are_noted_once() {
    let mut graph = PoseGraph::new(AGREEMENT).with_passes(PASSES);
    // Nodes every 20 m, which is a pass each, and back to the first place each time.
    (0..8u64).for_each(|i| graph.add_node(i, &at(if i % 2 == 0 { 0.0 } else { 20.0 })));
    let loops: Vec<Edge> = (1..4).map(|i| edge(0, 2 * i, 0.3)).collect();
    for edge in &loops {
        assert_eq!(graph.add_edge(LinkKind::Loop, edge), Ok(EdgeOutcome::Added));
    }
    assert_eq!((graph.take_closed().len(), graph.counts().open_loops), (0, 3), "0.3 m apart is not closed");
    for k in 0..3 {
        let moved: Vec<(NodeId, Pose)> = (1..4).map(|i| (2 * i, at(if k == 1 { 0.0 } else { 0.3 }))).collect();
        graph.update_poses(&moved);
        graph.refresh_loops();
        assert_eq!(graph.take_closed().len(), if k == 1 { 0 } else { 3 });
    }
    assert_eq!(graph.counts().retired_links, 0, "three passes");
    for i in 4..6 {
        graph.add_node(2 * i, &at(0.0));
        graph.add_node(2 * i + 1, &at(20.0));
        graph.add_edge(LinkKind::Loop, &edge(0, 2 * i, 0.0)).unwrap();
    }
    let counts = graph.counts();
    assert_eq!((counts.loop_edges, counts.retired_links, counts.open_loops), (5, 1, 0));
    let reached: Vec<NodeId> = graph.within(&[0], 5.0).into_iter().map(|(node, _)| node).collect();
    assert_eq!(reached.len(), 1 + FIRST + LAST, "{reached:?}");
    assert!(!reached.contains(&6), "the third pass is the first that goes: {reached:?}");
}
