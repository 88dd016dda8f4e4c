//! How long the ground of a map takes that grows: all of it anew, and kept up. `kept_up WORLD SCANS VOXEL`.

use std::time::{Duration, Instant};
use voxelastic::event::Event;
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::{Mapper, Pose};
use voxelastic_ground::{Body, Ground, GroundTiles};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [world, scans, voxel] = arguments.as_slice() else { panic!("kept_up WORLD SCANS VOXEL") };
    let (scans, voxel_size) = (scans.parse().unwrap(), voxel.parse().unwrap());
    let settings = Settings { voxel_size, max_range: 40.0, field: FieldKind::Both, lambda_odom: 20.0, ..Settings::default() };
    let sim = Simulation::new(SimOptions { scans: Some(scans), columns: Some(512), spacing: 2.0, ..SimOptions::of(world) }).unwrap();
    let mut mapper = Mapper::new(settings).unwrap();
    let resolution: f64 = voxel.parse().unwrap();
    let mut tiles = GroundTiles::new(resolution, mapper.atlas().query().unwrap().voxel_size()).unwrap();
    println!("| scans | cells | anew, ms | what changed, ms | floor of it, ms |\n| --- | --- | --- | --- | --- |");
    let ms = |clock: Instant| clock.elapsed().as_secs_f64() * 1e3;
    let mut look = |mapper: &Mapper, name: &str, with_whole: bool| {
        let clock = Instant::now();
        tiles.note(mapper.atlas()).unwrap();
        tiles.make(mapper.atlas(), [0.0; 2], Duration::MAX).unwrap();
        let changed = ms(clock);
        if !with_whole {
            return;
        }
        let clock = Instant::now();
        let Ok(kept) = Ground::of_tiles(tiles.copy(mapper.atlas()), &Body::default()) else { return };
        let grids: Vec<_> = kept.storeys().iter().map(|storey| kept.grid(storey)).collect();
        let floor = ms(clock);
        let clock = Instant::now();
        let whole = Ground::of(mapper.atlas(), resolution, &Body::default()).unwrap();
        let anew = whole.storeys().iter().map(|storey| whole.grid(storey)).collect::<Vec<_>>();
        println!("| {name} | {} | {:.0} | {changed:.0} | {floor:.0} |", kept.columns().cells().count(), ms(clock));
        assert!(grids == anew);
    };
    for (k, scan) in sim.scans(PoseSource::Truth).enumerate() {
        mapper.handle(Event::Scan(scan)).unwrap();
        look(&mapper, &(k + 1).to_string(), (k + 1) % (scans / 4).max(1) == 0);
    }
    let half = mapper.atlas().scan_count() as u64 / 2;
    let moved = (half..2 * half).map(|node| (node, Pose::translation(0.1, 0.0, 0.0) * mapper.pose(node).unwrap())).collect();
    mapper.handle(Event::PoseUpdate(moved)).unwrap();
    look(&mapper, "half of them corrected", true);
}
