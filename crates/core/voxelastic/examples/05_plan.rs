//! Planning during mapping: a snapshot of the map for the planner, waypoints that follow corrections, and a recheck.
//!
//! ```sh
//! cargo run --release -p voxelastic --example 05_plan
//! ```

use voxelastic::event::Event;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic_plan::{FlyingSpace, Point, Request, Robot, Snapshot, anchor_path, plan, recheck, resolve_anchors};
use voxelastic_sim::{SimOptions, Simulation};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut settings = Settings { voxel_size: 0.08, ..Settings::default() };
    settings.set("field", "occupancy")?;
    let mut mapper = Mapper::builder().settings(settings).build()?;
    let simulation = Simulation::new(SimOptions { scans: Some(24), columns: Some(512), ..SimOptions::of("room") })?;
    let mut events = simulation.events();
    let mut scans = 0;
    for event in events.by_ref() {
        scans += usize::from(matches!(event, Event::Scan(_)));
        mapper.handle(event)?;
        if scans == 12 {
            break;
        }
    }

    // The planner owns the snapshot and can run on another thread.
    let snapshot = Snapshot::of(mapper.atlas());
    let robot = Robot::flying(0.3);
    let planner = std::thread::spawn(move || {
        let found = plan(&snapshot.query(), &Request::new([-3.0, -2.5, 1.2], [3.0, 1.0, 1.5], robot))?;
        let anchors = anchor_path(snapshot.atlas(), &found.path);
        Ok::<_, voxelastic_plan::PlanError>((found, anchors))
    });
    for event in events {
        mapper.handle(event)?;
    }
    let (found, anchors) = planner.join().map_err(|_| "the planner panicked")??;
    println!("{:.2} m, first path after {:.1} ms, {:.2} m from the nearest obstacle", found.length, 1e3 * found.first.seconds, found.least_clearance);

    // Meanwhile scans were added and submaps may have moved. Move the waypoints with them and check the path.
    let path: Vec<Point> = resolve_anchors(mapper.atlas(), &anchors).into_iter().flatten().collect();
    let now = Snapshot::of(mapper.atlas());
    let map = now.query();
    let bounds = map.bounds();
    let space = FlyingSpace::new(&map, &robot, [bounds.min.map(f64::from), bounds.max.map(f64::from)]);
    for blocked in recheck(&space, &map, &path) {
        println!("segment {} is blocked after {:.2} m, at {:.2?}", blocked.segment, blocked.free, blocked.at);
    }
    println!("{} waypoints checked", path.len());
    Ok(())
}
