//! Time, error and memory of distance fields that are kept up while a place is mapped, as a table:
//! `cargo run --release -p voxelastic-esdf --example figures -- [WORLD [SCANS]]`. One thread, processor time; 20 cm (or a third
//! argument, metres), 60 m, distances up to 2 m.

#![allow(clippy::print_stdout)]

use rustix::time::{ClockId, clock_gettime};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, UnknownAs};
use voxelastic::settings::FieldKind;
use voxelastic::surface::{MeshOptions, extract};
use voxelastic::{Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfSample, EsdfSettings};
use voxelastic_eval::{MeshIndex, MeshView};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

const MAX_DISTANCE: f64 = 2.0;

/// Processor time of the process, milliseconds.
fn now() -> f64 {
    let t = clock_gettime(ClockId::ProcessCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = now();
    (work(), now() - start)
}

/// Whether the map has something occupied where the surface is that is nearest to a point, within a voxel along the way to it.
fn has_nearest(map: &AtlasQuery<'_>, p: [f64; 3], distance: impl Fn([f64; 3]) -> f64) -> bool {
    const STEP: f64 = 0.01;
    let moved = |axis: usize, by: f64| std::array::from_fn(|k| p[k] + if k == axis { by } else { 0.0 });
    let away: [f64; 3] = std::array::from_fn(|axis| distance(moved(axis, STEP)) - distance(moved(axis, -STEP)));
    let length = away.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
    let here = distance(p);
    (-4..=4).any(|k| {
        let by = here + f64::from(k) / 4.0 * map.voxel_size();
        map.state(std::array::from_fn(|axis| p[axis] - away[axis] / length * by)) == State::Occupied
    })
}

/// Distance of each point to the nearest of all submaps' meshes, metres, at most the largest distance.
fn to_meshes(atlas: &Atlas, points: &[[f64; 3]]) -> Vec<f64> {
    let mut nearest = vec![MAX_DISTANCE; points.len()];
    for submap in atlas.submaps() {
        let mesh = extract(submap.tsdf(), atlas.voxel_size(), &MeshOptions::default());
        let Some(index) = MeshView::new(&mesh.positions, &mesh.triangles).ok().and_then(|view| MeshIndex::new(&view).ok()) else { continue };
        let t_submap_map = submap.t_map_submap().inverse();
        for (nearest, p) in nearest.iter_mut().zip(points) {
            let local = (t_submap_map * nalgebra::Point3::from(*p)).coords.map(|c| c as f32);
            *nearest = index.closest(local.into(), MAX_DISTANCE as f32).map_or(*nearest, |closest| nearest.min(f64::from(closest.distance)));
        }
    }
    nearest
}

fn report(name: &str, of: &str, mut errors: Vec<f64>) {
    errors.sort_by(f64::total_cmp);
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!(
        "error by {name}, {of}: mean {:.1} cm, median {:.1} cm, {} in free space 0.2 to 1.8 m from a surface",
        100.0 * mean,
        100.0 * errors[errors.len() / 2],
        errors.len()
    );
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let world = arguments.next().unwrap_or_else(|| "campus".to_owned());
    let scans = arguments.next().map_or(Ok(60), |n| n.parse())?;
    let voxel_size: f32 = arguments.next().map_or(Ok(0.2), |metres| metres.parse())?;
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let simulation = Simulation::new(SimOptions { scans: Some(scans), ..SimOptions::of(&world) })?;
    let mut mapper = Mapper::new(Settings { voxel_size, field: FieldKind::Both, ..Settings::default() })?;
    let both = [UnknownAs::Free, UnknownAs::Blocked];
    let mut fields = both
        .map(|unknown| (Esdf::new(EsdfSettings { max_distance: MAX_DISTANCE, unknown }, voxel_size), Vec::new(), 0))
        .into_iter()
        .collect::<Vec<_>>();
    for scan in simulation.scans(PoseSource::Truth) {
        mapper.handle(Event::Scan(scan))?;
        for (esdf, times, recomputed) in &mut fields {
            let esdf = esdf.as_mut().map_err(|error| error.to_string())?;
            let (stats, time) = timed(|| esdf.update(mapper.atlas()));
            times.push(time);
            *recomputed += stats.recomputed;
        }
    }
    let atlas = mapper.atlas();
    println!("{world}, {scans} scans 2 m apart, {} submaps", atlas.submaps().len());
    println!("| to | first, ms | median, ms | 95 %, ms | most after the first, ms | blocks a scan | rebuild, ms | MB | million samples/s |");
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let truth = simulation.world();
    let bounds = atlas.query().unwrap().bounds();
    let points: Vec<[f64; 3]> = (0..1 << 20)
        .map(|i| {
            let share = |step: f64| (f64::from(i) * step).fract();
            let at = [share(0.754_877_666), share(0.569_840_29), share(0.430_159_71)];
            std::array::from_fn(|k| f64::from(bounds.min[k]) + at[k] * f64::from(bounds.size()[k]))
        })
        .collect();
    for ((esdf, times, recomputed), unknown) in fields.into_iter().zip(both) {
        let esdf = esdf?;
        let (_, rebuild) = timed(|| Esdf::new(esdf.settings(), voxel_size).map(|mut esdf| esdf.update(atlas)));
        let query = esdf.query(atlas);
        let (_, time) = timed(|| query.sample_many(&points));
        let mut later = times[1..].to_vec();
        later.sort_by(f64::total_cmp);
        let at = |share: f64| later.get((share * (later.len() - 1) as f64) as usize).copied().unwrap_or(0.0);
        let name = if unknown == UnknownAs::Free { "obstacles" } else { "obstacles and unknown" };
        println!(
            "| {name} | {:.1} | {:.1} | {:.1} | {:.1} | {} | {rebuild:.0} | {:.0} | {:.1} |",
            times[0],
            at(0.5),
            at(0.95),
            at(1.0),
            recomputed / scans,
            esdf.bytes() as f64 / 1e6,
            points.len() as f64 / time / 1e3
        );
        if unknown == UnknownAs::Free {
            let map = atlas.query().unwrap();
            let inside: Vec<[f64; 3]> =
                points.iter().copied().filter(|p| map.state(*p) == State::Free && (0.2..1.8).contains(&truth.distance(*p))).take(30_000).collect();
            let to_surfaces = || query.sample_many_to_surfaces(&inside);
            let (_, first) = timed(to_surfaces);
            let (surfaces, again) = timed(to_surfaces);
            println!("{} points to surfaces: {first:.0} ms at first, {again:.0} ms again, {:.0} MB in all", inside.len(), esdf.bytes() as f64 / 1e6);
            let distances = |samples: Vec<EsdfSample>| samples.iter().map(|s| f64::from(s.distance)).collect::<Vec<_>>();
            let methods =
                [("voxels", distances(query.sample_many(&inside))), ("surfaces", distances(surfaces)), ("the meshes", to_meshes(atlas, &inside))];
            for (name, distances) in methods {
                let errors: Vec<(bool, f64)> = inside
                    .iter()
                    .zip(distances)
                    .map(|(p, d)| (has_nearest(&map, *p, |p| truth.distance(p)), (d - truth.distance(*p)).abs()))
                    .collect();
                report(name, "all points", errors.iter().map(|(_, error)| *error).collect());
                report(name, "points whose nearest surface is in the map", errors.iter().filter(|(has, _)| *has).map(|(_, error)| *error).collect());
            }
        }
    }
    Ok(())
}
