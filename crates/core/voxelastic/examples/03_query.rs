//! Queries on a stored map: state of a point, collision check, distance, ray and frontier.
//!
//! ```sh
//! cargo run --release -p voxelastic --example 03_query                # room.vox, written by example 01
//! cargo run --release -p voxelastic --example 03_query -- map.vox
//! ```

use std::path::PathBuf;
use voxelastic::query::{Ray, Sphere, UnknownAs};
use voxelastic_io::store::MapStore;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let map = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("room.vox"), PathBuf::from);
    let atlas = MapStore::open(map)?.load_atlas()?;
    let query = atlas.query()?;
    let bounds = query.bounds();
    println!("occupancy of {:.1?} to {:.1?} m, voxels of {} m", bounds.min, bounds.max, query.voxel_size());

    // Where the sensor was first, in the map frame.
    let submap = atlas.submaps().first().ok_or("the map has no submap")?;
    let first = submap.scans().first().ok_or("the submap has no scan")?;
    let at: [f64; 3] = (submap.t_map_submap() * first.t_submap_lidar).translation.vector.into();

    let robot = Sphere { centre: at, radius: 0.3 }.into();
    println!("at {at:.2?}: {:?}", query.state(at));
    println!("sphere of 0.3 m free: {}", query.is_free(&robot, UnknownAs::Blocked));
    println!("nearest obstacle or unknown space: {:.2} m", query.clearance(at, 5.0, UnknownAs::Blocked));
    match query.ray_cast(&Ray { origin: at, direction: [1.0, 0.0, 0.0], length: 20.0 }, UnknownAs::Blocked) {
        Some(hit) => println!("ray along x ends after {:.2} m at {:?} space", hit.distance, hit.state),
        None => println!("ray along x is free for 20 m"),
    }
    let area: f64 = query.frontier(3).iter().map(|point| point.area).sum();
    println!("frontier to unknown space: {area:.1} m2");
    Ok(())
}
