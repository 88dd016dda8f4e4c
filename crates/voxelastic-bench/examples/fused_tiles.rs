//! What it costs to keep the fused surface of a map up to date, scan by scan.
//!
//! ```sh
//! cargo run --release -p voxelastic-bench --example fused_tiles            # the simulated campus at 6.5 cm, with drift
//! cargo run --release -p voxelastic-bench --example fused_tiles -- room 50 # another world, the first 50 scans
//! ```

#![allow(clippy::print_stdout)]

use std::time::Instant;
use voxelastic::event::Event;
use voxelastic::meshing::FusedSurface;
use voxelastic::surface::MeshOptions;
use voxelastic::{Mapper, Settings};
use voxelastic_eval::SeriesStats;
use voxelastic_sim::{SimOptions, Simulation};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let world = arguments.first().map_or("campus", String::as_str);
    let limit = arguments.get(1).map_or(Ok(usize::MAX), |n| n.parse())?;
    let mut mapper = Mapper::new(Settings::default())?;
    let mut surface = FusedSurface::new(MeshOptions::default());
    let (mut scans, mut corrections, mut tiles) = (Vec::new(), Vec::new(), Vec::new());
    let simulation = Simulation::new(SimOptions::of(world))?;
    let mut is_corrected = false;
    for event in simulation.events() {
        is_corrected |= matches!(event, Event::PoseUpdate(_));
        let before = mapper.elastic_counts().fusions;
        let is_scan = mapper.handle(event)?.is_some();
        is_corrected |= mapper.elastic_counts().fusions != before;
        if !is_scan {
            continue;
        }
        let clock = Instant::now();
        let changed = surface.update(mapper.atlas()).len();
        let times = if std::mem::take(&mut is_corrected) { &mut corrections } else { &mut scans };
        times.push(clock.elapsed().as_secs_f64() * 1e3);
        tiles.push(changed as f64);
        if scans.len() + corrections.len() >= limit {
            break;
        }
    }
    for (what, values, unit) in [("scans", &scans, "ms"), ("scans after a correction or a fusion", &corrections, "ms"), ("changed tiles", &tiles, "")]
    {
        let SeriesStats { median, p95, mean } = SeriesStats::new(values);
        println!(
            "{}, {what}: median {:.1} {unit}, 95 % {:.1}, mean {:.1}",
            values.len(),
            median.unwrap_or(0.0),
            p95.unwrap_or(0.0),
            mean.unwrap_or(0.0)
        );
    }
    println!("{} triangles on {} threads", surface.mesh().triangles.len(), rayon::current_num_threads());
    Ok(())
}
