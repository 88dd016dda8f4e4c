//! From a folder of scans and poses to a map on disk, with the library: the core of `voxelastic map`.
//!
//! ```sh
//! cargo run --release -p voxelastic --example 01_map_a_folder                       # simulates a small room first, makes room.vox
//! cargo run --release -p voxelastic --example 01_map_a_folder -- DATA map.vox       # your own folder
//! ```
#![allow(clippy::print_stderr)]

use std::ops::ControlFlow;
use std::path::PathBuf;
use voxelastic::event::Event;
use voxelastic::mapper::Mapper;
use voxelastic::settings::Settings;
use voxelastic_io::dataset::{self, OpenOptions};
use voxelastic_io::store::{MapDetails, MapWriter};
use voxelastic_sim::{SimOptions, Simulation};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> Result<()> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let simulated = std::env::temp_dir().join(format!("voxelastic-example-{}", std::process::id()));
    let (data, map) = match arguments.as_slice() {
        [] => {
            Simulation::new(SimOptions { scans: Some(20), columns: Some(512), drift: 0.0, ..SimOptions::of("room") })?
                .write(&simulated, &mut |_, _| ControlFlow::Continue(()))?;
            (simulated.clone(), PathBuf::from("room.vox"))
        }
        [data, map] => (data.clone(), map.clone()),
        _ => return Err("usage: no arguments, or DATA and MAP.vox".into()),
    };

    // Detects the layout of the folder; no cloud is decoded yet.
    let dataset = dataset::open(&data, &OpenOptions::default())?;
    println!("{}", dataset.description());

    // `voxelastic config` lists all settings with their defaults.
    let mut settings = Settings::default();
    settings.set("voxel_size", "0.05")?;
    settings.set("field", "both")?;
    let mut mapper = Mapper::builder().settings(settings.clone()).build()?;

    // Clouds are decoded ahead on another thread. A bad cloud is an error item; the iteration continues after it.
    for event in dataset.events() {
        match event {
            Err(problem) => eprintln!("skipped: {problem}"),
            Ok(event @ Event::Scan(_)) => {
                let started = std::time::Instant::now();
                if let Some(report) = mapper.handle(event)? {
                    println!("node {}: {} returns in submap {}, {:.1?}", report.node, report.counts.usable, report.submap, started.elapsed());
                }
            }
            Ok(edge_or_correction) => drop(mapper.handle(edge_or_correction)?),
        }
    }
    println!("sensor: {}", mapper.sensor().unwrap_or("unknown"));

    // The map on disk is replaced atomically.
    let details = MapDetails {
        generator: "01_map_a_folder".into(),
        settings: settings.pairs().into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
        ..MapDetails::default()
    };
    let saved = MapWriter::create(&map)?.save(mapper.atlas(), &details)?;
    println!("{} submaps, {:.1} MB in {}", mapper.atlas().submaps().len(), saved.bytes as f64 / 1e6, map.display());
    if simulated.exists() {
        std::fs::remove_dir_all(simulated)?;
    }
    Ok(())
}
