//! Tests of the public interface of simulations.

use super::*;
use voxelastic::geometry::PoseExt;

fn quick(world: &str, scans: usize) -> Result<Simulation, SimError> {
    Simulation::new(SimOptions { scans: Some(scans), columns: Some(64), ..SimOptions::of(world) })
}

#[test]
fn events_are_ordered() -> Result<(), SimError> {
    let simulation = quick("campus", 210)?;
    let (mut scans, mut edges, mut loops) = (0, 0, 0);
    let mut events = simulation.events().peekable();
    while let Some(event) = events.next() {
        match event {
            Event::Scan(scan) => {
                assert_eq!(scan.node, scans);
                scans += 1;
            }
            Event::OdometryEdge(edge) => {
                assert_eq!((edge.from, edge.to), (edges, edges + 1));
                assert_eq!(scans, edge.to + 1, "after both its nodes");
                edges += 1;
            }
            Event::LoopEdge(edge) => {
                assert_eq!(scans, edge.to + 1);
                let Some(Event::PoseUpdate(update)) = events.peek() else { panic!("a loop edge without update") };
                assert_eq!(update.len() as u64, scans);
                loops += 1;
            }
            _ => {}
        }
    }
    assert_eq!((scans, edges, loops), (210, 209, simulation.loop_edges().len()));
    Ok(())
}

#[test]
fn online_poses_return_to_the_truth_at_loop_closures() -> Result<(), SimError> {
    let simulation = quick("street", 400)?;
    let off = |k: usize, source| simulation.poses(source)[k].translation_distance(&simulation.ground_truth()[k]);
    let first = simulation.loop_edges()[0].to as usize;
    assert_eq!(off(first, PoseSource::Online), off(first, PoseSource::Odometry), "odometry until the first closure");
    assert!(off(first, PoseSource::Online) > 0.3 && off(first + 1, PoseSource::Online) < 0.2);
    assert!(off(399, PoseSource::Online) < 0.4 && off(399, PoseSource::Odometry) > 0.5);
    Ok(())
}

#[test]
fn visible_surface_lies_on_the_world() -> Result<(), SimError> {
    let simulation = quick("room", 5)?;
    let surface = simulation.visible_surface(0.2, 60.0);
    assert!(surface.len() > 2000, "{}", surface.len());
    for s in &surface {
        assert!(simulation.world().distance(s.point).abs() < 1e-6);
        let out = std::array::from_fn(|k| s.point[k] + 1e-3 * s.normal[k]);
        assert!(simulation.world().distance(out) > -1e-6);
    }
    let cubes: HashSet<[i32; 3]> = surface.iter().map(|s| s.point.map(|c| (c / 0.2).floor() as i32)).collect();
    assert_eq!(cubes.len(), surface.len());
    assert!(simulation.visible_surface(0.2, 2.0).len() < surface.len());
    Ok(())
}

#[test]
fn rate_sets_times_and_bad_options_are_rejected() -> Result<(), SimError> {
    let simulation = Simulation::new(SimOptions { rate: Some(10.0), scans: Some(4), ..SimOptions::of("campus") })?;
    assert!(simulation.times().iter().zip([0.0, 0.1, 0.2, 0.3]).all(|(a, b)| (a - b).abs() < 1e-12));
    let bad = [
        SimOptions { spacing: 0.0, ..SimOptions::default() },
        SimOptions { rate: Some(f64::NAN), ..SimOptions::default() },
        SimOptions { scans: Some(0), ..SimOptions::default() },
        SimOptions { drift: -1.0, ..SimOptions::default() },
        SimOptions { sensor: "os9".into(), ..SimOptions::default() },
        SimOptions { columns: Some(1), ..SimOptions::default() },
        SimOptions { seed: u64::MAX, ..SimOptions::default() },
        SimOptions { world: "moon".into(), ..SimOptions::default() },
    ];
    assert!(bad.into_iter().all(|options| Simulation::new(options).is_err()));
    Ok(())
}
