//! What it costs to show distances around a robot while it maps, as the live node does: `cargo run --release -p voxelastic-esdf --example slices -- [WORLD [SCANS]]`.
//! After each scan a slice of 20 m x 20 m at the height of the robot; 6.5 cm, 60 m, distances up to 2 m, two threads, wall time. At the end the whole field, for
//! comparison.

#![allow(clippy::print_stdout)]

use std::time::Instant;
use voxelastic::settings::FieldKind;
use voxelastic::{Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfSettings, LocalEsdf};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    (work(), start.elapsed().as_secs_f64() * 1e3)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let world = arguments.next().unwrap_or_else(|| "campus".to_owned());
    let scans = arguments.next().map(|n| n.parse()).transpose()?;
    rayon::ThreadPoolBuilder::new().num_threads(2).build_global()?;
    let simulation = Simulation::new(SimOptions { scans, ..SimOptions::of(&world) })?;
    let mut mapper = Mapper::new(Settings { field: FieldKind::Both, ..Settings::default() })?;
    let new = || LocalEsdf::new(EsdfSettings::default(), Settings::default().voxel_size);
    let (mut esdf, mut kept, mut times) = (new()?, new()?, Vec::new());
    let (mut first, mut answers) = (0.0, 0);
    for scan in simulation.scans(PoseSource::Truth) {
        let here = scan.t_map_lidar.translation;
        mapper.handle(Event::Scan(scan))?;
        let step = |k: i32| 20.0 / 128.0 * f64::from(k);
        let points: Vec<[f64; 3]> = (-64..=64).flat_map(|y| (-64..=64).map(move |x| [here.x + step(x), here.y + step(y), here.z])).collect();
        let (samples, time) = timed(|| esdf.sample_many_to_surfaces(mapper.atlas(), &points));
        times.push(time);
        answers += samples.len();
        kept = new()?;
        first = timed(|| kept.sample_many_to_surfaces(mapper.atlas(), &points)).1;
    }
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times.get((share * (times.len() - 1) as f64) as usize).copied().unwrap_or(0.0);
    println!("{world}: {} slices, {answers} answers, {} submaps", times.len(), mapper.atlas().submaps().len());
    println!("after each scan: median {:.0} ms, 95 % {:.0} ms, most {:.0} ms; {:.1} MB", at(0.5), at(0.95), at(1.0), esdf.bytes() as f64 / 1e6);
    println!("the first of somebody who asks at the end: {first:.0} ms, {:.1} MB", kept.bytes() as f64 / 1e6);
    let (whole, time) = timed(|| {
        let mut whole = Esdf::new(EsdfSettings::default(), Settings::default().voxel_size)?;
        whole.update(mapper.atlas());
        Ok::<_, voxelastic_esdf::EsdfError>(whole)
    });
    println!("the whole field: {time:.0} ms, {:.0} MB", whole?.bytes() as f64 / 1e6);
    Ok(())
}
