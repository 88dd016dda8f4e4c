//! Plan while mapping goes on, with the library: a snapshot of the map to plan in, waypoints that follow corrections, and a recheck.
//!
//! ```sh
//! cargo run --release --example 03_plan
//! ```

use voxelastic::event::Event;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic_plan::{Air, Point, Request, Robot, Snapshot, anchor, place, plan, recheck};
use voxelastic_sim::{SimOptions, Simulation};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut settings = Settings { voxel: 0.08, ..Settings::default() };
    settings.set("field", "occupancy")?;
    let voxel = settings.voxel;
    let mut mapper = Mapper::new(settings)?;
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

    // The snapshot is the planner's own: another thread can plan in it while this one maps on.
    let snapshot = Snapshot::of(mapper.atlas(), voxel);
    let robot = Robot::flying(0.3);
    let planner = std::thread::spawn(move || {
        let found = plan(&snapshot.query(), &Request::new([-3.0, -2.5, 1.2], [3.0, 1.0, 1.5], robot))?;
        let anchors = anchor(snapshot.atlas(), &found.path);
        Ok::<_, voxelastic_plan::PlanError>((found, anchors))
    });
    for event in events {
        mapper.handle(event)?;
    }
    let (found, anchors) = planner.join().map_err(|_| "the planner ended early")??;
    println!("{:.2} m, first path after {:.1} ms, {:.2} m from the nearest obstacle", found.length, 1e3 * found.first.seconds, found.least_clearance);

    // Meanwhile the map has grown and may have bent. Where is the path now, and does it still hold?
    let path: Vec<Point> = place(mapper.atlas(), &anchors).into_iter().flatten().collect();
    let now = Snapshot::of(mapper.atlas(), voxel);
    let map = now.query();
    let bounds = map.bounds();
    let air = Air::new(&map, &robot, [bounds.min.map(f64::from), bounds.max.map(f64::from)]);
    for broken in recheck(&air, &map, &path) {
        println!("piece {} is blocked after {:.2} m, at {:.2?}", broken.piece, broken.free, broken.at);
    }
    println!("{} waypoints checked", path.len());
    Ok(())
}
