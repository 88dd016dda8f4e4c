//! The surface as 3D Tiles, with a page that streams them.

use std::borrow::Borrow;
use std::io::Write;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::meshing::SurfaceTiles;
use voxelastic::surface::Mesh;
use voxelastic_earth::Georeference;
use voxelastic_eval::colour::{Ramp, Rgb};
use voxelastic_io::Result;
use voxelastic_io::tiles::{TilesetReport, TilesetWriter, leaves, remove_from_earth, split, write_on_earth};
use voxelastic_report::tiles_page;

/// Writes a surface tile by tile. `step` is told the triangles so far, and those of all.
///
/// # Errors
/// When a tile cannot be written.
pub fn stream<A: Borrow<Atlas>>(surface: &SurfaceTiles<A>, voxel: f32, writer: &mut TilesetWriter, step: &mut dyn FnMut(u64, u64)) -> Result<()> {
    let (low, high) = surface.height_range();
    let (all, mut done) = (surface.triangles().max(1), 0);
    leaves(surface, f64::from(voxel), |cell, mut mesh| {
        if mesh.colours.is_empty() {
            mesh.colours = by_height(&mesh.positions, low, high);
        }
        done += mesh.triangles.len() as u64;
        writer.leaf(cell, mesh)?;
        step(done, all);
        Ok(())
    })
}

/// Writes a surface that was made as a whole. `step` is told the tiles so far, and all.
///
/// # Errors
/// When a tile cannot be written.
pub fn write_whole(mut mesh: Mesh, voxel: f32, writer: &mut TilesetWriter, step: &mut dyn FnMut(u64, u64)) -> Result<()> {
    if mesh.colours.is_empty() {
        let (low, high) = height_range(&mesh.positions);
        mesh.colours = by_height(&mesh.positions, low, high);
    }
    let leaves = split(&mesh, f64::from(voxel));
    drop(mesh);
    let all = leaves.len() as u64;
    for (done, (cell, mesh)) in (1..).zip(leaves) {
        writer.leaf(cell, mesh)?;
        step(done, all);
    }
    Ok(())
}

/// Completes the folder: with the page, and the list of all tiles; of a map on Earth, with `earth.json`, which says where that is.
///
/// # Errors
/// When something cannot be written.
pub fn finish(writer: TilesetWriter, folder: &Path, title: &str, place: Option<&Georeference>) -> crate::Result<TilesetReport> {
    for (name, bytes) in tiles_page::FILES {
        let path = folder.join(name);
        voxelastic_files::write(&path, |file| file.write_all(bytes))
            .map_err(|e| crate::Error::new(format!("cannot write {}: {e}", path.display()), ""))?;
    }
    let report = writer.finish(title)?;
    match place.and_then(Georeference::t_ecef_map).filter(|_| report.is_some()) {
        Some(t_ecef_map) => write_on_earth(folder, &t_ecef_map)?,
        None => remove_from_earth(folder)?,
    }
    Ok(report.unwrap_or_default())
}

fn by_height(positions: &[[f32; 3]], low: f32, high: f32) -> Vec<Rgb> {
    positions.iter().map(|p| Ramp::Land.at((p[2] - low) / (high - low))).collect()
}

/// Range of the height colours, metres: the 1st and 99th percentiles, so that outliers do not matter.
pub fn height_range(positions: &[[f32; 3]]) -> (f32, f32) {
    let mut heights: Vec<f32> = positions.iter().map(|p| p[2]).filter(|z| z.is_finite()).collect();
    heights.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| heights.get(((heights.len().saturating_sub(1)) as f64 * share).round() as usize).copied().unwrap_or(0.0);
    let (low, high) = (at(0.01), at(0.99));
    (low, high.max(low + 0.01))
}
