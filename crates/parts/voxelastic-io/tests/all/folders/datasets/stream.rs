//! The registered cloud list as it comes out.

use super::*;
use std::time::Duration;
use voxelastic_io::g2o;

#[test]
fn scans_edges_and_loops_in_order() {
    let folder = Folder::with_scans(4);
    g2o::write(folder.file("graph.g2o"), &graph(&[0, 1, 2, 3], &[(3, 0), (0, 2)])).unwrap();
    let dataset = folder.open().unwrap();
    assert_eq!(story(&dataset), "S0 S1 O0-1 S2 O1-2 L0-2 S3 O2-3 L3-0");
    for event in dataset.events() {
        match event.unwrap() {
            Event::Scan(scan) => assert_eq!(scan.cloud.points, [[scan.node as f32 + 1.0, 0.0, 0.0]]),
            Event::OdometryEdge(edge) => assert_eq!((edge.t_from_to, edge.information), (pose(2.5), Some([1.0; 21]))),
            Event::LoopEdge(edge) => assert_eq!(edge.t_from_to, pose(0.1)),
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn nodes_are_named_as_the_graph_names_them() {
    let folder = Folder::with_scans(3);
    folder.kitti("poses.txt", 3, 7.0);
    g2o::write(folder.file("graph.g2o"), &graph(&[10, 20, 30], &[(30, 10)])).unwrap();
    let dataset = folder.open().unwrap();
    assert_eq!(xs(&dataset), [7.0, 9.0, 11.0], "the trajectory goes before the graph's vertices");
    assert_eq!(story(&dataset), "S10 S20 O10-20 S30 O20-30 L30-10");
}

#[test]
fn a_graph_of_more_nodes_than_clouds_is_tied_by_number() {
    let folder = Folder::new();
    [0, 2, 3].iter().for_each(|k| folder.cloud(&format!("scans/{k:06}.pcd"), *k));
    g2o::write(folder.file("graph.g2o"), &graph(&[0, 1, 2, 3], &[(3, 0), (3, 1)])).unwrap();
    let dataset = folder.open().unwrap();
    assert_eq!(xs(&dataset), [0.0, 4.0, 6.0]);
    assert_eq!(story(&dataset), "S0 S2 O0-2 S3 O2-3 L3-0");
    assert_eq!(dataset.description().loop_edges_without_scan, 1);
}

#[test]
fn a_bad_scan_is_an_item_and_the_rest_goes_on() {
    let folder = Folder::with_scans(4);
    g2o::write(folder.file("graph.g2o"), &graph(&[0, 1, 2, 3], &[(3, 0), (3, 1)])).unwrap();
    let bytes = std::fs::read(folder.file("scans/000001.pcd")).unwrap();
    std::fs::write(folder.file("scans/000001.pcd"), &bytes[..bytes.len() - 1]).unwrap();
    let dataset = folder.open().unwrap();
    assert_eq!(story(&dataset), "S0 ! S2 O0-2 S3 O2-3 L3-0");
    let error = dataset.events().find_map(Result::err).unwrap();
    assert!(error.path().ends_with("000001.pcd") && error.to_string().contains("truncated"), "{error}");
    // The bridge over the gap is the poses' own.
    let bridge = dataset.events().find_map(|e| match e {
        Ok(Event::OdometryEdge(edge)) => Some(edge),
        _ => None,
    });
    assert_eq!(bridge.unwrap().t_from_to, pose(4.0));
}

#[test]
fn base_poses_become_lidar_poses() {
    let folder = Folder::with_scans(2);
    let turned = Pose::rotation(nalgebra::Vector3::z() * std::f64::consts::FRAC_PI_2);
    let t_map_base = [Pose::identity(), pose(2.0) * turned];
    poses::write_kitti(folder.file("poses.txt"), &t_map_base).unwrap();
    let nodes = vec![(0, t_map_base[0]), (1, t_map_base[1])];
    let odometry = Edge { t_from_to: t_map_base[0].inv_mul(&t_map_base[1]), ..edge(0, 1, 0.0) };
    g2o::write(folder.file("graph.g2o"), &PoseGraph { nodes, edges: vec![odometry], fixed: vec![] }).unwrap();
    let t_base_lidar = Pose::translation(0.5, 0.0, 1.0);
    let dataset = folder.open_with(OpenOptions { t_base_lidar: Some(t_base_lidar), ..OpenOptions::default() }).unwrap();
    let second = dataset.scans()[1].t_map_lidar.translation.vector;
    assert!((second - nalgebra::Vector3::new(2.0, 0.5, 1.0)).norm() < 1e-9, "{second}");
    for event in dataset.events() {
        if let Event::OdometryEdge(edge) = event.unwrap() {
            let expected = dataset.scans()[0].t_map_lidar.inv_mul(&dataset.scans()[1].t_map_lidar);
            assert!((edge.t_from_to.to_homogeneous() - expected.to_homogeneous()).amax() < 1e-9);
        }
    }
}

#[test]
fn snapshots_become_pose_updates() {
    let folder = Folder::with_scans(5);
    folder.kitti("poses.txt", 5, 0.0);
    folder.kitti("poses@000001.txt", 2, 0.5);
    folder.tum("poses@000003.tum", 4, 0.0, 1.0, 0.7);
    g2o::write(folder.file("poses@000004.g2o"), &graph(&[0, 1, 2, 3, 4], &[])).unwrap();
    let dataset = folder.open().unwrap();
    assert_eq!(story(&dataset), "S0 S1 O0-1 U2 S2 O1-2 S3 O2-3 U4 S4 O3-4 U5");
    let update = dataset.events().find_map(|e| match e {
        Ok(Event::PoseUpdate(update)) => Some(update),
        _ => None,
    });
    assert_eq!(update.unwrap(), [(0, pose(0.5)), (1, pose(2.5))]);
    assert_eq!(dataset.description().snapshots, 3);
    for (most, cut_short) in
        [(9, "S0 S1 O0-1 U2 S2 O1-2 S3 O2-3 U4 S4 O3-4 U5"), (4, "S0 S1 O0-1 U2 S2 O1-2 S3 O2-3 U4"), (3, "S0 S1 O0-1 U2 S2 O1-2")]
    {
        let mut first = dataset.clone();
        first.truncate(most);
        assert_eq!(story(&first), cut_short, "what came later is not known yet");
    }

    folder.text("poses@000001.txt", "1 0 0 0 0 1 0 0 0 0 1 zero\n1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 0\n");
    assert_eq!(story(&folder.open().unwrap()), "S0 S1 O0-1 ! S2 O1-2 S3 O2-3 U4 S4 O3-4 U5");
}

#[test]
fn scans_after_a_snapshot_go_on_from_it() {
    let taken = |folder: &Folder| -> Vec<f64> {
        let events = folder.open().unwrap().events().map(Result::unwrap);
        events.filter_map(|e| if let Event::Scan(scan) = e { Some(scan.t_map_lidar.translation.x) } else { None }).collect()
    };
    let write = |folder: &Folder, xs: &[f64]| poses::write_kitti(folder.file("poses.txt"), &xs.iter().map(|x| pose(*x)).collect::<Vec<_>>()).unwrap();
    for has_graph in [false, true] {
        let folder = Folder::with_scans(6);
        if has_graph {
            let chain = PoseGraph { edges: (0..5).map(|k| edge(k, k + 1, 2.0)).collect(), ..graph(&[0, 1, 2, 3, 4, 5], &[]) };
            g2o::write(folder.file("graph.g2o"), &chain).unwrap();
        }
        folder.kitti("poses@000002.txt", 3, 0.5);
        folder.kitti("poses@000004.txt", 5, -1.0);
        write(&folder, &[0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(taken(&folder), [0.0, 2.0, 4.0, 6.5, 8.5, 9.0], "odometry goes on from the corrected poses");
        write(&folder, &[0.0, 2.0, 4.0, 6.5, 8.5, 9.0]);
        assert_eq!(taken(&folder), [0.0, 2.0, 4.0, 6.5, 8.5, 9.0], "a file with the corrections in it is left alone");
    }
}

#[test]
fn snapshots_do_not_correct_the_truth() {
    let folder = Folder::with_scans(3);
    folder.kitti("poses.txt", 3, 0.0);
    folder.kitti("groundtruth.txt", 3, 5.0);
    folder.kitti("poses@000001.txt", 2, 0.5);
    assert_eq!(story(&folder.open().unwrap()), "S0 S1 O0-1 U2 S2 O1-2");
    let truth = folder.open_with(with_poses("groundtruth")).unwrap();
    assert_eq!(story(&truth), "S0 S1 O0-1 S2 O1-2");
    assert_eq!(truth.description().snapshots, 0);
    assert!(truth.description().to_string().contains("1 pose snapshots are ignored"));
}

#[test]
fn points_are_timed_from_their_scan() {
    let folder = Folder::new();
    let stamp = 1_583_836_591.25;
    let text = format!(
        "FIELDS x y z timestamp\nSIZE 4 4 4 8\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n1 0 0 {}\n2 0 0 {}\n",
        stamp - 0.0625,
        stamp + 0.03125
    );
    std::fs::create_dir(folder.file("scans")).unwrap();
    folder.text("scans/1583836591_250000000.pcd", &text);
    folder.tum("poses.tum", 1, stamp, 1.0, 0.0);
    let dataset = folder.open().unwrap();
    let Some(Ok(Event::Scan(scan))) = dataset.events().next() else { panic!("no scan") };
    assert_eq!((scan.time, scan.cloud.time.unwrap()), (stamp, vec![-0.0625, 0.03125]));
}

#[test]
fn clouds_are_read_when_they_are_needed() {
    let folder = Folder::with_scans(12);
    folder.kitti("poses.txt", 12, 0.0);
    let dataset = folder.open().unwrap();
    let mut events = dataset.events();
    assert!(matches!(events.next(), Some(Ok(Event::Scan(_)))));
    std::thread::sleep(Duration::from_millis(200));
    // One delivered, two waiting, one in the decoder's hands: the fifth has not been opened.
    (4..12).for_each(|k| std::fs::remove_file(folder.file(&format!("scans/{k:06}.pcd"))).unwrap());
    let rest: Vec<_> = events.collect();
    assert_eq!(rest.iter().filter(|e| e.is_err()).count(), 8);
    assert_eq!(rest.iter().filter(|e| matches!(e, Ok(Event::Scan(_)))).count(), 3);
}

#[test]
fn scans_can_be_held_out() {
    let folder = Folder::with_scans(6);
    g2o::write(folder.file("graph.g2o"), &graph(&[0, 1, 2, 3, 4, 5], &[(4, 0), (5, 1)])).unwrap();
    let mut dataset = folder.open().unwrap();
    dataset.retain(|scan| scan.index % 3 != 1);
    assert_eq!(story(&dataset), "S0 S2 O0-2 S3 O2-3 S5 O3-5");
    assert_eq!(dataset.description().loop_edges_without_scan, 2);
}
