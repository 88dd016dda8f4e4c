//! Round trips and errors of simulated folders.

use super::*;
use crate::sensor::LidarSettings;

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn small() -> SimOptions {
    SimOptions { columns: Some(256), scans: Some(9), lidar: LidarSettings { moving: true, ..LidarSettings::default() }, ..SimOptions::of("room") }
}

#[test]
fn folder_round_trip() -> Outcome {
    let dir = tempfile::tempdir()?;
    let mut options = small();
    options.scans = Some(30);
    options.loops.least_path = 8.0;
    options.loops.spacing = 4.0;
    let simulation = Simulation::new(options)?;
    let mut calls = Vec::new();
    let written = simulation.write(dir.path(), &mut |done, all| {
        calls.push((done, all));
        ControlFlow::Continue(())
    })?;
    assert_eq!((written, calls.last()), (30, Some(&(30, 30))));
    for k in [0, 29] {
        let read = pcd::read(dir.path().join(format!("scans/{k:06}.pcd")))?.cloud;
        let cloud = simulation.cloud(k).unwrap_or_default();
        assert_eq!((read.width, read.height), (256, 64));
        let bits = |points: &[[f32; 3]]| points.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&read.points), bits(&cloud.points));
        assert_eq!((read.ring, read.time, read.intensity), (cloud.ring, cloud.time, cloud.intensity));
    }
    let odometry = poses::read(dir.path().join("poses.tum"))?;
    assert_eq!(odometry.times.as_deref(), Some(simulation.times()));
    let close = |a: &Pose, b: &Pose| (a.translation.vector - b.translation.vector).norm() < 1e-9 && a.rotation.angle_to(&b.rotation) < 1e-7;
    assert!(odometry.poses.iter().zip(simulation.odometry()).all(|(a, b)| close(a, b)));
    assert_eq!(poses::read(dir.path().join("groundtruth.tum"))?.len(), 30);
    let graph = g2o::read(dir.path().join("graph.g2o"))?;
    let (chain, loops) = graph.split_edges();
    assert_eq!((graph.nodes.len(), chain.len(), loops.len()), (30, 29, simulation.loop_edges().len()));
    assert!(loops.len() > 2);
    let first = &simulation.corrections()[0];
    assert_eq!(poses::read(dir.path().join(format!("poses@{:06}.txt", first.node)))?.len(), first.poses.len());
    let again = Simulation::load(dir.path())?;
    assert_eq!(again.options(), simulation.options());
    assert_eq!(World::load(dir.path().join(WORLD_FILE))?.fingerprint(), simulation.world().fingerprint());
    Ok(())
}

#[test]
fn stopped_writing_leaves_a_consistent_folder() -> Outcome {
    let dir = tempfile::tempdir()?;
    let simulation = Simulation::new(SimOptions { scans: Some(200), columns: Some(16), ..small() })?;
    let written = simulation.write(dir.path(), &mut |_, _| ControlFlow::Break(()))?;
    assert!(written < 200);
    assert_eq!(fs::read_dir(dir.path().join("scans"))?.count(), written);
    assert_eq!(poses::read(dir.path().join("poses.tum"))?.len(), written);
    assert_eq!(g2o::read(dir.path().join("graph.g2o"))?.nodes.len(), written);
    let loaded = Simulation::load(dir.path())?;
    assert_eq!(loaded.ground_truth(), &simulation.ground_truth()[..written], "the world file describes the scans in the folder");
    let bits = |s: &Simulation| s.cloud(written - 1).map(|c| c.points.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>());
    assert_eq!(bits(&loaded), bits(&simulation));
    assert!(matches!(simulation.write(dir.path(), &mut |_, _| ControlFlow::Continue(())), Err(SimError::NotEmpty { .. })));
    Ok(())
}

#[test]
fn bad_world_files_are_rejected() -> Outcome {
    let dir = tempfile::tempdir()?;
    let path = dir.path().join(WORLD_FILE);
    assert!(matches!(World::load(dir.path()), Err(SimError::File { .. })));
    let simulation = Simulation::new(small())?;
    simulation.write_world(dir.path(), simulation.len())?;
    let text = fs::read_to_string(&path)?;
    World::load(&path)?;
    for (from, to, word) in [
        ("format = 1", "format = 2", "format 2"),
        ("world = \"room\"", "world = \"roam\"", "unknown world"),
        ("seed = 1", "seed = \"one\"", "seed"),
        ("world = \"room\"", "wrld = \"room\"", "wrld"),
        ("fingerprint = \"", "fingerprint = \"0", "has changed"),
        ("format = 1", "format = ", "line"),
    ] {
        assert!(text.contains(from), "{from}");
        fs::write(&path, text.replacen(from, to, 1))?;
        let message = World::load(&path).map_or_else(|e| e.to_string(), |_| String::new());
        assert!(message.contains(word), "{word}: {message}");
    }
    Ok(())
}
