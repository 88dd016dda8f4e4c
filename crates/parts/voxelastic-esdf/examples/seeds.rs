//! What other distance fields need to be compared with this one: `cargo run --release -p voxelastic-esdf --example seeds -- WORLD SCANS FOLDER`. One thread; 20 cm, 60 m,
//! distances to obstacles up to 2 m, true poses, scans 2 m apart, as in the example `figures`.
//!
//! After each keyframe `FOLDER/NNNN.npy` has the occupied voxels (int32, shape (n, 3), voxels of the map frame) and a line on stdout what the update of our field took
//! (processor time, milliseconds). At the end `points.npy` has places in free space 0.2 to 1.8 m from a surface (float64, metres, map frame), `voxels.npy` our distances
//! there by voxels, `truth.npy` those of the world. `crates/tools/voxelastic-bench/peers/distance_fields.py FOLDER` reads them.

#![allow(clippy::print_stdout)]

use nalgebra::Point3;
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeSet;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::octree::{NONE, block_coords, block_key};
use voxelastic::query::UnknownAs;
use voxelastic::settings::FieldKind;
use voxelastic::{Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfSettings};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

const VOXEL: f32 = 0.2;
const MAX_DISTANCE: f64 = 2.0;

/// Processor time of the process, milliseconds.
fn now() -> f64 {
    let t = clock_gettime(ClockId::ProcessCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}

/// Writes an array as NumPy reads it.
fn write(file: &Path, kind: &str, shape: &str, bytes: impl Iterator<Item = u8>) -> std::io::Result<()> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    header += &" ".repeat(63 - (10 + header.len()) % 64);
    header.push('\n');
    let mut content = b"\x93NUMPY\x01\x00".to_vec();
    content.extend((header.len() as u16).to_le_bytes());
    content.extend(header.into_bytes());
    content.extend(bytes);
    std::fs::write(file, content)
}

/// The occupied voxels of all submaps, in voxels of the map frame.
fn occupied(atlas: &Atlas) -> BTreeSet<[i32; 3]> {
    let mut voxels = BTreeSet::new();
    for submap in atlas.submaps() {
        let (field, t_map_submap) = (submap.occupancy(), submap.t_map_submap());
        let mut blocks = Vec::new();
        field.tree().for_each(|key, level, octant| {
            // Everything above a block that is not divided any further is free or unknown: surfaces are in blocks.
            if level == 0 && octant.payload.max > 0 {
                blocks.push(key);
            } else if octant.link == NONE && octant.payload.max > 0 {
                let (low, edge) = (block_coords(key), 1i32 << level);
                blocks.extend((0..edge.pow(3)).map(|i| block_key([low[0] + i % edge, low[1] + i / edge % edge, low[2] + i / edge / edge])));
            }
        });
        for key in blocks {
            let (states, low) = (field.block_states(key), block_coords(key).map(|c| 8 * c));
            for i in (0..512i32).filter(|i| states.occupied[(i >> 6) as usize] >> (i & 63) & 1 == 1) {
                let centre = [low[0] + (i & 7), low[1] + (i >> 3 & 7), low[2] + (i >> 6)].map(|c| (f64::from(c) + 0.5) * f64::from(VOXEL));
                let placed: [f64; 3] = (t_map_submap * Point3::from(centre)).coords.into();
                voxels.insert(placed.map(|c| (c / f64::from(VOXEL)).floor() as i32));
            }
        }
    }
    voxels
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [world, scans, folder] = &arguments[..] else { return Err("give WORLD SCANS FOLDER".into()) };
    let (scans, folder): (usize, &Path) = (scans.parse()?, folder.as_ref());
    std::fs::create_dir_all(folder)?;
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    let simulation = Simulation::new(SimOptions { scans: Some(scans), ..SimOptions::of(world) })?;
    let mut mapper = Mapper::new(Settings { voxel_size: VOXEL, field: FieldKind::Occupancy, ..Settings::default() })?;
    let mut esdf = Esdf::new(EsdfSettings { max_distance: MAX_DISTANCE, unknown: UnknownAs::Free }, VOXEL)?;
    for (k, scan) in simulation.scans(PoseSource::Truth).enumerate() {
        mapper.handle(Event::Scan(scan))?;
        let start = now();
        esdf.update(mapper.atlas());
        let time = now() - start;
        let voxels = occupied(mapper.atlas());
        write(&folder.join(format!("{k:04}.npy")), "<i4", &format!("{}, 3", voxels.len()), voxels.iter().flatten().flat_map(|c| c.to_le_bytes()))?;
        println!("{k} {time:.2} ms {} occupied voxels", voxels.len());
    }
    let atlas = mapper.atlas();
    let start = now();
    Esdf::new(esdf.settings(), VOXEL)?.update(atlas);
    println!("rebuild {:.2} ms", now() - start);
    let (map, truth) = (atlas.query().unwrap(), simulation.world());
    let bounds = map.bounds();
    let place = |i: u32| -> [f64; 3] {
        let at = [0.754_877_666, 0.569_840_29, 0.430_159_71].map(|step: f64| (f64::from(i) * step).fract());
        std::array::from_fn(|k| f64::from(bounds.min[k]) + at[k] * f64::from(bounds.size()[k]))
    };
    let is_near = |p: &[f64; 3]| map.state(*p) == State::Free && (0.2..1.8).contains(&truth.distance(*p));
    let points: Vec<[f64; 3]> = (0..1 << 20).map(place).filter(is_near).collect();
    let start = now();
    let samples = esdf.query(atlas).sample_many(&points);
    println!("{} points {:.2} ms", points.len(), now() - start);
    let numbers = |values: Vec<f64>| values.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>().into_iter();
    let count = points.len();
    write(&folder.join("voxels.npy"), "<f8", &format!("{count},"), numbers(samples.iter().map(|s| f64::from(s.distance)).collect()))?;
    write(&folder.join("truth.npy"), "<f8", &format!("{count},"), numbers(points.iter().map(|p| truth.distance(*p)).collect()))?;
    write(&folder.join("points.npy"), "<f8", &format!("{count}, 3"), numbers(points.into_iter().flatten().collect()))?;
    Ok(())
}
