//! Maps with pose corrections, and the counts reported for them.

use crate::{json, room, run, works};
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic_io::{PoseGraph, g2o, poses};

/// The numbers at `key` of the objects of a list.
fn numbers(list: &serde_json::Value, key: &str) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|entry| entry[key].as_f64().unwrap_or_else(|| panic!("no {key} in {entry}"))).collect()
}

#[test]
fn corrections_reduce_the_errors_of_poses() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street -o street --laps 1.3 --spacing 5 --columns 64");
    let report = json(dir.path(), "map street --voxel-size 0.4 --max-range 20 --report --json");
    let (loops, corrections) = (&report["loops"], &report["corrections"]);
    assert!(loops.as_array().unwrap().len() >= 5 && numbers(corrections, "after").len() == numbers(loops, "after").len(), "{report}");
    assert_eq!(numbers(loops, "after"), numbers(corrections, "after"), "a correction comes with each loop");
    assert!(numbers(corrections, "wall_ms").iter().all(|ms| *ms > 0.0) && corrections[0]["optimise_ms"].is_null(), "{corrections}");
    assert!(numbers(corrections, "moved")[0] >= 3.0 && numbers(corrections, "closed")[0] == 1.0, "{corrections}");
    let log = std::fs::read_to_string(dir.path().join("street.vox/run.json")).unwrap();
    assert_eq!(serde_json::from_str::<serde_json::Value>(&log).unwrap()["loops"], *loops);
    assert!(std::fs::read_to_string(dir.path().join("street.html")).unwrap().contains("Loop closures"));

    // All scans end where they were taken, those after corrections included: what is left is drift within a submap.
    let error = |map: &str| {
        let found = json(dir.path(), &format!("eval {map} --truth street --field tsdf --max-points 2000 --json"));
        found["trajectory"]["ate_in_place"]["translation_m"]["max"].as_f64().unwrap()
    };
    let elastic = error("street.vox");
    works(dir.path(), "map street -o all.vox --voxel-size 0.4 --max-range 20 --rebuild");
    let rebuilt = error("all.vox");
    std::fs::read_dir(dir.path().join("street"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.to_string_lossy().contains("poses@"))
        .for_each(|snapshot| std::fs::remove_file(snapshot).unwrap());
    works(dir.path(), "map street -o odometry.vox --voxel-size 0.4 --max-range 20");
    let odometry = error("odometry.vox");
    works(dir.path(), "map street -o optimized.vox --voxel-size 0.4 --max-range 20 --optimize");
    let optimized = error("optimized.vox");
    println!("largest error of a pose: odometry {odometry:.2} m, elastic {elastic:.2} m, rebuilt {rebuilt:.2} m, optimised {optimized:.2} m");
    assert!(optimized < 0.5 * odometry, "{odometry} {optimized}");
    assert!(elastic < 0.3 * odometry && rebuilt < 0.5 * elastic && rebuilt < 0.2, "{odometry} {elastic} {rebuilt}");
}

/// The layout of SC-A-LOAM, SC-LIO-SAM and FAST-LIO-SLAM: poses before and after optimisation, side by side.
#[test]
fn dumps_with_poses_before_and_after_optimisation_need_no_flag() {
    const SCANS: usize = 4;
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("dump");
    room::write(&data, SCANS);
    std::fs::remove_file(data.join("poses.tum")).unwrap();
    let nodes: Vec<(NodeId, Pose)> = (0..SCANS).map(|i| (i as NodeId, room::pose(i))).collect();
    let edge = |a: usize, b: usize| Edge { from: a as NodeId, to: b as NodeId, t_from_to: nodes[a].1.inv_mul(&nodes[b].1), information: None };
    let edges = (1..SCANS).map(|i| edge(i - 1, i)).chain([edge(0, SCANS - 1)]).collect();
    let true_poses: Vec<Pose> = nodes.iter().map(|(_, pose)| *pose).collect();
    // The odometry drifts upwards.
    let drifting: Vec<Pose> = true_poses.iter().enumerate().map(|(i, pose)| Pose::translation(0.0, 0.0, 0.05 * i as f64) * pose).collect();
    poses::write_kitti(data.join("optimized_poses.txt"), &true_poses).unwrap();
    poses::write_kitti(data.join("odom_poses.txt"), &drifting).unwrap();
    g2o::write(data.join("singlesession_posegraph.g2o"), &PoseGraph { nodes, edges, fixed: vec![0] }).unwrap();

    let plain = run(dir.path(), "map dump -o plain.vox");
    assert_eq!(plain.code, Some(0), "{}", plain.err);
    assert!(plain.err.contains("poses: optimized_poses.txt") && plain.err.contains("odom_poses.txt are not used"), "{}", plain.err);
    let optimised = run(dir.path(), "map dump -o optimised.vox --optimize");
    assert_eq!(optimised.code, Some(0), "{}", optimised.err);
    assert!(optimised.err.contains("poses: odom_poses.txt") && optimised.err.contains("graph: singlesession_posegraph.g2o"), "{}", optimised.err);
}

mod optimize {
    use super::*;
    use crate::fails;
    use std::fs;

    /// Four nodes along x whose loop edge says that the last is at 3.3 m and not at 3.
    fn graph(loop_information: &str) -> String {
        let unit = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 100 0 0 100 0 100";
        let vertices: String = (0..4).map(|i| format!("VERTEX_SE3:QUAT {i} {i} 0 0 0 0 0 1\n")).collect();
        let edges: String = (0..3).map(|i| format!("EDGE_SE3:QUAT {i} {} 1 0 0 0 0 0 1 {unit}\n", i + 1)).collect();
        format!("{vertices}{edges}EDGE_SE3:QUAT 0 3 3.3 0 0 0 0 0 1 {}\n", if loop_information.is_empty() { unit } else { loop_information })
    }

    #[test]
    fn graphs_are_optimised_and_bad_ones_refused() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("graph.g2o"), graph("")).unwrap();
        let report = json(dir.path(), "optimize graph.g2o -o out.g2o --json");
        // Three equal edges against one: half of 100 x (3 x 0.075^2 + 0.075^2).
        assert!((report["cost_before"].as_f64().unwrap() - 4.5).abs() < 1e-6 && (report["cost"].as_f64().unwrap() - 1.125).abs() < 1e-3, "{report}");
        assert!(report["converged"] == true && report["uncoupled"] == 0);
        let again = json(dir.path(), "optimize out.g2o -o twice.g2o --json");
        assert!((again["cost_before"].as_f64().unwrap() - report["cost"].as_f64().unwrap()).abs() < 1e-6, "{again}");

        fs::write(dir.path().join("coupled.g2o"), graph("100 0 0 0 0 0 100 0 0 0 0 100 5000 0 0 100 0 0 100 0 100")).unwrap();
        let coupled = json(dir.path(), "optimize coupled.g2o -o out.g2o --json");
        assert!(coupled["uncoupled"] == 1 && coupled["cost"] == report["cost"], "{coupled}");
        fs::write(dir.path().join("negative.g2o"), graph("-100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 100 0 0 100 0 100")).unwrap();
        fails(dir.path(), "optimize negative.g2o -o out.g2o", 1, &["negative.g2o", "node 0 to node 3", "positive definite"]);
        fails(dir.path(), "optimize nowhere.g2o -o out.g2o", 1, &["nowhere.g2o"]);
        fails(dir.path(), "optimize graph.g2o -o out.g2o --huber=-1", 2, &["--huber", "0 or more"]);
    }
}
