//! Time of the frontier after each scan, its update and its clusters, while a place is mapped: `cargo run --release -p voxelastic-explore --example frontier -- [WORLD [SCANS]]`.
//! One thread, wall time; voxels of 10 cm, 30 m, scans 1 m apart with true poses, submaps of ten metres and more.

#![allow(clippy::print_stdout)]

use std::time::Instant;
use voxelastic::settings::FieldKind;
use voxelastic::{Settings, event::Event, mapper::Mapper};
use voxelastic_explore::{FrontierSettings, Frontiers};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

fn report(name: &str, times: &[f64]) {
    let sorted = |times: &[f64]| {
        let mut sorted = times.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted
    };
    let (all, third) = (sorted(times), times.len() / 3);
    let at = |share: f64| all[(share * (all.len() - 1) as f64) as usize];
    let [first, last] = [&times[..third], &times[times.len() - third..]].map(|part| sorted(part).get(third / 2).copied().unwrap_or_default());
    println!(
        "{name}: median {:.2} ms ({first:.2} in the first third, {last:.2} in the last), 95 % {:.2} ms, most {:.2} ms",
        at(0.5),
        at(0.95),
        at(1.0)
    );
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let world = arguments.next().unwrap_or_else(|| "mine".to_owned());
    let scans = arguments.next().map_or(Ok(120), |n| n.parse())?;
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let simulation = Simulation::new(SimOptions { scans: Some(scans), columns: Some(512), spacing: 1.0, ..SimOptions::of(&world) })?;
    let settings = Settings { voxel_size: 0.1, max_range: 30.0, field: FieldKind::Occupancy, lambda_odom: 10.0, ..Settings::default() };
    let mut mapper = Mapper::new(settings)?;
    let mut frontiers = Frontiers::new(FrontierSettings::default(), [[-1e3; 3], [1e3; 3]]);
    let (mut queries, mut updates, mut clusterings, mut all) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut blocks, mut clusters) = (0, 0);
    for scan in simulation.scans(PoseSource::Truth) {
        mapper.handle(Event::Scan(scan))?;
        let atlas = mapper.atlas();
        let start = Instant::now();
        let map = atlas.query().unwrap();
        queries.push(1e3 * start.elapsed().as_secs_f64());
        let start = Instant::now();
        blocks += frontiers.update(atlas);
        let updated = start.elapsed();
        clusters += frontiers.clusters(atlas, &map).len();
        let done = start.elapsed();
        updates.push(1e3 * updated.as_secs_f64());
        clusterings.push(1e3 * (done - updated).as_secs_f64());
        all.push(1e3 * done.as_secs_f64());
    }
    println!(
        "{world}, {scans} scans, {} submaps, {} blocks and {} clusters a scan",
        mapper.atlas().submaps().len(),
        blocks / scans,
        clusters / scans
    );
    report("query of the map", &queries);
    report("update", &updates);
    report("clusters", &clusterings);
    report("update and clusters", &all);
    Ok(())
}
