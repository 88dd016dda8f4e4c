//! What it costs to keep the fused surface of a map up to date, scan by scan.
//!
//! ```sh
//! cargo run --release -p voxelastic-bench --example fused_tiles            # the simulated campus at 6.5 cm, with drift
//! cargo run --release -p voxelastic-bench --example fused_tiles -- room 50 # another world, the first 50 scans
//! ```
//!
//! After each scan it finds out what changed and copies what the tiles around the robot are made of, which the scan after it waits for; then it makes these tiles, as another
//! thread does in the live node, and goes on with others, the oldest first, until 20 ms are over. What is left after the last scan is made then.

#![allow(clippy::print_stdout)]

use std::collections::HashMap;
use std::time::Instant;
use voxelastic::event::Event;
use voxelastic::meshing::{SurfaceChanges, TileKey, TileMaker};
use voxelastic::surface::MeshOptions;
use voxelastic::{Mapper, Settings};
use voxelastic_eval::SeriesStats;
use voxelastic_sim::{SimOptions, Simulation};

/// What may be spent on a scan, milliseconds.
const BUDGET: f64 = 20.0;
/// Tiles that are made at a time.
const AT_ONCE: usize = 4;

/// What was measured, by scan.
#[derive(Default)]
struct Series {
    note_ms: Vec<f64>,
    gather_ms: Vec<f64>,
    near_ms: Vec<f64>,
    all_ms: Vec<f64>,
    near: Vec<f64>,
    made: Vec<f64>,
    waiting: Vec<f64>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let world = arguments.first().map_or("campus", String::as_str);
    let limit = arguments.get(1).map_or(Ok(usize::MAX), |n| n.parse())?;
    let mut mapper = Mapper::new(Settings::default())?;
    let (mut surface, mut maker) = (SurfaceChanges::default(), TileMaker::new(MeshOptions { lod: 1, ..MeshOptions::default() }));
    let (mut scans, mut corrections, mut is_corrected) = (Series::default(), Series::default(), false);
    let mut made_at: HashMap<TileKey, usize> = HashMap::new();
    let simulation = Simulation::new(SimOptions::of(world))?;
    for event in simulation.events() {
        is_corrected |= matches!(event, Event::PoseUpdate(_));
        let before = mapper.elastic_counts().fusions;
        let node = if let Event::Scan(scan) = &event { Some(scan.node) } else { None };
        mapper.handle(event)?;
        is_corrected |= mapper.elastic_counts().fusions != before;
        let Some(robot) = node.and_then(|node| mapper.pose(node)) else { continue };
        let series = if std::mem::take(&mut is_corrected) { &mut corrections } else { &mut scans };
        let count = made_at.len();
        let clock = Instant::now();
        let spent = || clock.elapsed().as_secs_f64() * 1e3;
        surface.note(mapper.atlas());
        series.note_ms.push(spent());
        let at = <[f64; 3]>::from(robot.translation.vector).map(|c| c as f32);
        let place = surface.tile_at(at).map(|tile| surface.place(tile)).unwrap_or_default();
        let is_near = |tile: &TileKey| (0..3).all(|k| (surface.place(*tile)[k] - place[k]).abs() <= 1);
        let near: Vec<TileKey> = surface.waiting().filter(is_near).collect();
        let work = surface.gather(mapper.atlas(), &near);
        series.gather_ms.push(spent());
        let begin = spent();
        surface.wait_for(&maker.make(&work).again);
        series.near_ms.push(spent() - begin);
        series.near.push(near.len() as f64);
        let mut made = near.len();
        let mut others: Vec<TileKey> = surface.waiting().collect();
        others.sort_by_key(|tile| (made_at.get(tile).copied(), *tile));
        for tiles in others.chunks(AT_ONCE) {
            if spent() >= BUDGET {
                break;
            }
            let mut tiles = tiles.to_vec();
            tiles.sort_unstable();
            let work = surface.gather(mapper.atlas(), &tiles);
            surface.wait_for(&maker.make(&work).again);
            made += tiles.len();
            made_at.extend(tiles.into_iter().map(|tile| (tile, count)));
        }
        series.all_ms.push(spent());
        series.made.push(made as f64);
        series.waiting.push(surface.waiting().count() as f64);
        if scans.note_ms.len() + corrections.note_ms.len() >= limit {
            break;
        }
    }
    for (what, series) in [("scans", &scans), ("scans after a correction or a fusion", &corrections)] {
        println!("{} {what}", series.note_ms.len());
        let rows = [
            ("to find what changed, ms", &series.note_ms),
            ("and to copy what the tiles around the robot are made of, ms", &series.gather_ms),
            ("to make these tiles, ms", &series.near_ms),
            ("tiles around the robot", &series.near),
            ("all with others, ms", &series.all_ms),
            ("tiles made", &series.made),
            ("tiles left", &series.waiting),
        ];
        for (what, values) in rows {
            let SeriesStats { median, p95, mean } = SeriesStats::new(values);
            println!("  {what}: median {:.1}, 95 % {:.1}, mean {:.1}", median.unwrap_or(0.0), p95.unwrap_or(0.0), mean.unwrap_or(0.0));
        }
    }
    let clock = Instant::now();
    let (mut made, mut triangles) = (0, 0);
    loop {
        let some: Vec<TileKey> = surface.waiting().take(64).collect();
        if some.is_empty() {
            break;
        }
        made += some.len();
        let made = maker.make(&surface.gather(mapper.atlas(), &some));
        surface.wait_for(&made.again);
        triangles += made.meshes.iter().map(|(_, mesh)| mesh.triangles.len()).sum::<usize>();
    }
    let (seconds, megabytes) = (clock.elapsed().as_secs_f64(), maker.bytes() as f64 / 1e6);
    println!(
        "{made} tiles left at the end: {seconds:.2} s, {triangles} triangles; fused field {megabytes:.0} MB; {} threads",
        rayon::current_num_threads()
    );
    Ok(())
}
