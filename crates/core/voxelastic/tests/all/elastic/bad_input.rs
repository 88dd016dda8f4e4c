//! Invalid input from a SLAM system: refused or counted, and the map is unchanged.

use crate::elastic::settings;
use crate::elastic::town::{LAP, Town};
use voxelastic::event::{Edge, Event, NodeId};
use voxelastic::mapper::MapError;
use voxelastic::sensor::SensorError;
use voxelastic::{Mapper, Pose};

fn edge(from: NodeId, to: NodeId, t_from_to: Pose) -> Edge {
    Edge { from, to, t_from_to, information: None }
}

fn mapper_with(nodes: &[(NodeId, f64)]) -> (Town, Mapper) {
    let (town, mut mapper) = (Town::new(), Mapper::new(settings()).unwrap());
    for &(node, s) in nodes {
        mapper.handle(town.scan(node, &Town::pose(s), &Town::pose(s))).unwrap();
    }
    (town, mapper)
}

#[test]
fn duplicates_and_impossible_numbers_are_refused_by_name() {
    let (town, mut mapper) = mapper_with(&[(3, 0.0), (4, 2.0)]);
    let bytes = mapper.atlas().bytes();
    let pose = Town::pose(4.0);
    assert_eq!(mapper.handle(town.scan(3, &pose, &pose)).unwrap_err(), MapError::DuplicateNode { node: 3 });
    let bad = Pose::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(mapper.handle(town.scan(5, &pose, &bad)).unwrap_err(), MapError::BadPose { node: 5 });
    assert_eq!(mapper.handle(Event::PoseUpdate(vec![(3, pose), (4, bad)])).unwrap_err(), MapError::BadPose { node: 4 });
    assert_eq!(mapper.atlas().submaps()[0].t_map_submap(), Town::pose(0.0), "an update is applied completely or not at all");
    assert!(mapper.handle(Event::LoopEdge(edge(3, 3, pose))).unwrap_err().to_string().contains("node 3 to itself"));
    assert!(mapper.handle(Event::OdometryEdge(edge(3, 4, bad))).unwrap_err().to_string().contains("from node 3 to node 4"));
    assert_eq!((mapper.atlas().bytes(), mapper.atlas().scan_count()), (bytes, 2));
    mapper.handle(town.scan(5, &pose, &pose)).unwrap();
}

#[test]
fn edges_and_updates_of_unknown_nodes_are_counted() {
    let (town, mut mapper) = mapper_with(&[(0, 0.0), (1, 2.0)]);
    mapper.handle(Event::LoopEdge(edge(0, 99, Pose::identity()))).unwrap();
    mapper.handle(Event::OdometryEdge(edge(98, 97, Pose::identity()))).unwrap();
    mapper.handle(Event::PoseUpdate(vec![(55, Pose::identity()), (1, Town::pose(2.0))])).unwrap();
    assert_eq!((mapper.graph_counts().waiting_edges, mapper.elastic_counts().unknown_poses), (2, 1));
    let pose = Town::pose(0.0);
    mapper.handle(town.scan(99, &pose, &pose)).unwrap();
    assert_eq!((mapper.graph_counts().waiting_edges, mapper.graph_counts().loop_edges), (1, 1));
    assert_eq!(mapper.atlas().scan_count(), 3);
}

#[test]
fn a_loop_that_is_an_outlier_fuses_nothing() {
    let nodes: Vec<(NodeId, f64)> = (0..40).map(|i| (i, 2.0 * i as f64)).collect();
    let (_, mut mapper) = mapper_with(&nodes);
    let submaps = mapper.atlas().submaps().len();
    assert!(submaps > 2);
    for (from, to) in [(0, 20), (5, 35), (10, 39)] {
        let wrong = Town::pose(2.0 * from as f64).inv_mul(&Town::pose(2.0 * to as f64)) * Pose::translation(20.0, 0.0, 0.0);
        mapper.handle(Event::LoopEdge(edge(from, to, wrong))).unwrap();
    }
    mapper.finish();
    assert_eq!((mapper.atlas().submaps().len(), mapper.elastic_counts().fusions), (submaps, 0));
    assert_eq!(mapper.graph_counts().open_loops, 3);
}

#[test]
fn events_out_of_order_and_a_graph_in_pieces_lose_nothing() {
    let (town, mut mapper) = (Town::new(), Mapper::new(settings()).unwrap());
    // A loop and a correction first, then scans backward, then a second piece far away, then the edge that joins them.
    mapper.handle(Event::LoopEdge(edge(0, 88, Town::pose(0.0).inv_mul(&Town::pose(LAP - 1.0))))).unwrap();
    mapper.handle(Event::PoseUpdate((0..90).map(|i| (i, Town::pose(2.0 * i as f64))).collect())).unwrap();
    assert_eq!(mapper.elastic_counts().unknown_poses, 90);
    for i in (0..30u64).rev().chain(60..88) {
        mapper.handle(town.scan(i, &Town::pose(2.0 * i as f64), &Town::pose(2.0 * i as f64))).unwrap();
        if i > 0 && i != 60 {
            let measured = Town::pose(2.0 * (i - 1) as f64).inv_mul(&Town::pose(2.0 * i as f64));
            mapper.handle(Event::OdometryEdge(edge(i - 1, i, measured))).unwrap();
        }
    }
    mapper.handle(town.scan(88, &Town::pose(LAP - 1.0), &Town::pose(LAP - 1.0))).unwrap();
    mapper.handle(Event::PoseUpdate((0..89).rev().map(|i| (i, Town::pose(2.0 * i as f64))).collect())).unwrap();
    mapper.finish();
    assert_eq!(mapper.atlas().scan_count(), 59);
    assert_eq!(mapper.atlas().submaps().iter().map(|s| s.tsdf().len()).filter(|blocks| *blocks == 0).count(), 0);
}

#[test]
fn the_last_update_of_a_node_is_effective() {
    let (_, mut mapper) = mapper_with(&(0..30).map(|i| (i, 2.0 * i as f64)).collect::<Vec<_>>());
    let roots: Vec<NodeId> = mapper.atlas().submaps().iter().filter_map(|s| s.root_node()).collect();
    assert!(roots.len() > 2);
    let moved = |i: NodeId, up: f64| (i, Pose::translation(0.0, 0.0, up) * Town::pose(2.0 * i as f64));
    // Newer poses first, older ones after them, one of a part of the nodes last, and one node twice in it.
    mapper.handle(Event::PoseUpdate((0..30).map(|i| moved(i, 2.0)).collect())).unwrap();
    mapper.handle(Event::PoseUpdate((0..30).rev().map(|i| moved(i, 1.0)).collect())).unwrap();
    mapper.handle(Event::PoseUpdate(vec![moved(roots[1], 9.0), moved(roots[1], 3.0)])).unwrap();
    for (submap, &root) in mapper.atlas().submaps().iter().zip(&roots) {
        let up = if root == roots[1] { 3.0 } else { 1.0 };
        assert_eq!(submap.t_map_submap(), moved(root, up).1, "submap of node {root}");
    }
}

#[test]
fn a_graph_in_two_pieces_is_two_maps_until_an_edge_joins_them() {
    // Two parts of the lap without an edge between them: the first node of the second part follows no other.
    let (town, mut mapper) = mapper_with(&(0..12).map(|i| (i, 2.0 * i as f64)).collect::<Vec<_>>());
    let there = |i: NodeId| Town::pose(2.0 * i as f64);
    for i in 40..52 {
        mapper.handle(town.scan(i, &there(i), &there(i))).unwrap();
    }
    let of = |mapper: &Mapper, node: NodeId| mapper.atlas().submaps().iter().find(|s| s.scans().iter().any(|scan| scan.node == node)).unwrap().id();
    assert_ne!(of(&mapper, 11), of(&mapper, 40));
    // A correction of one piece leaves the other where it is.
    let lifted = |i: NodeId| Pose::translation(0.0, 0.0, 5.0) * there(i);
    mapper.handle(Event::PoseUpdate((40..52).map(|i| (i, lifted(i))).collect())).unwrap();
    for submap in mapper.atlas().submaps() {
        let root = submap.root_node().unwrap();
        assert_eq!(submap.t_map_submap(), if root < 40 { there(root) } else { lifted(root) });
    }
    mapper.finish();
    assert_eq!((mapper.atlas().scan_count(), mapper.elastic_counts().fusions), (24, 0));
}

#[test]
fn no_error_repeats_its_cause() {
    let reason = SensorError::TableLength { elevations: 2, offsets: 3 };
    let error = MapError::Sensor { node: 3, reason };
    assert!(error.to_string().contains("node 3") && error.to_string().contains("2 elevations"));
    let mut causes = std::iter::successors(std::error::Error::source(&error), |cause| cause.source());
    assert!(causes.all(|cause| !error.to_string().contains(&cause.to_string())), "{error}");
}
