//! Tiles of a square kilometre, from a map of a part of it that is repeated: what the page of tiles is measured on.
//!
//! ```sh
//! cargo run --release -p voxelastic-bench --example square_kilometre -- campus.vox km2/      # copies side by side until they cover 1 km^2
//! python3 crates/parts/voxelastic-report/page/tiles/measure.py km2/
//! ```

#![allow(clippy::print_stdout)]

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;
use voxelastic::geometry::Rigid;
use voxelastic::meshing::SurfaceTiles;
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic_eval::colour::Ramp;
use voxelastic_io::store::MapStore;
use voxelastic_io::tiles::{Cell, LEAF_EDGE, TilesetWriter, leaves};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, folder] = &arguments[..] else { return Err("usage: square_kilometre MAP.vox FOLDER".into()) };
    let atlas = MapStore::open(Path::new(map))?.load_atlas()?;
    let voxel = f64::from(atlas.voxel_size());
    let surface = SurfaceTiles::new(atlas, MeshOptions::default());
    let (low, high) = surface.height_range();
    let mut one: Vec<(Cell, Mesh)> = Vec::new();
    leaves(&surface, voxel, |cell, mut mesh| {
        if mesh.colours.is_empty() {
            mesh.colours = mesh.positions.iter().map(|p| Ramp::Land.at((p[2] - low) / (high - low))).collect();
        }
        one.push((cell, mesh));
        Ok(())
    })?;
    // Whole tiles apart, so that all copies have the same vertices.
    let extent: [u32; 2] = std::array::from_fn(|k| {
        let at = || one.iter().map(|(cell, _)| cell.coordinates()[k]);
        at().max().unwrap_or(0) - at().min().unwrap_or(0) + 1
    });
    let edge = voxel * f64::from(LEAF_EDGE);
    let copies = extent.map(|leaves| (1000.0 / (f64::from(leaves) * edge)).ceil() as u32);
    let mut placed: BTreeMap<u64, (Cell, usize, [u32; 2])> = BTreeMap::new();
    for (i, (cell, _)) in one.iter().enumerate() {
        for shift in (0..copies[0]).flat_map(|x| (0..copies[1]).map(move |y| [x * extent[0], y * extent[1]])) {
            let [x, y, z] = cell.coordinates();
            let there = Cell::new(0, [x + shift[0], y + shift[1], z]).ok_or("the copies reach too far")?;
            placed.insert(there.order(), (there, i, shift));
        }
    }
    let clock = Instant::now();
    let mut writer = TilesetWriter::create(folder, voxel)?;
    for (cell, i, shift) in placed.into_values() {
        let mut mesh = Mesh::default();
        let move_by = shift.map(|leaves| (f64::from(leaves) * edge) as f32);
        mesh.append(&one[i].1, &Rigid { translation: [move_by[0], move_by[1], 0.0], ..Rigid::from(&voxelastic::Pose::identity()) });
        writer.leaf(cell, mesh)?;
    }
    let report = writer.finish("square kilometre")?.ok_or("the map has no surface")?;
    for (name, bytes) in voxelastic_report::tiles_page::FILES {
        std::fs::write(Path::new(folder).join(name), bytes)?;
    }
    let metres = [0, 1].map(|k| f64::from(copies[k] * extent[k]) * edge);
    let size = format!("{:.0} x {:.0} m, {} x {} copies", metres[0], metres[1], copies[0], copies[1]);
    println!("{size}: {report:?}, {:.1} s for writing", clock.elapsed().as_secs_f64());
    Ok(())
}
