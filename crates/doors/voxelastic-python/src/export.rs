//! Maps in the formats of other programs.

use crate::map::{Content, Map};
use crate::{errors, job};
use pyo3::{PyResult, Python, pyfunction};
use std::path::{Path, PathBuf};
use voxelastic::atlas::Submap;
use voxelastic::meshing::SurfaceTiles;
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic_io::tiles::TilesetWriter;
use voxelastic_run::export::grid::GridOptions;
use voxelastic_run::export::octomap::Occupancy;
use voxelastic_run::export::{FORMATS, Format, cloud, grid, octomap, tiles};
use voxelastic_run::{Error, Result};

/// Writes a map in the format that the name of the file or folder says. `voxel` is for OctoMaps, `lod` and `min_weight` are for surfaces.
#[pyfunction]
pub fn export(py: Python<'_>, map: &Map, path: PathBuf, voxel: Option<f64>, lod: usize, min_weight: f32) -> PyResult<()> {
    let (content, pool) = (map.content()?, job::shared_pool()?);
    let options = MeshOptions { min_weight, lod, ..MeshOptions::default() };
    let write = move || pool.install(|| write(&content, &path, voxel, &options));
    job::run(py, write)?.map_err(|error| errors::run(py, &error))
}

fn write(content: &Content, path: &Path, voxel: Option<f64>, options: &MeshOptions) -> Result<()> {
    let format = Format::of(path).ok_or_else(|| Error::usage(format!("{}: not a known format", path.display()), FORMATS))?;
    match format {
        Format::Octomap { states_only } => {
            let occupancy = Occupancy { atlas: &content.atlas, settings: &content.settings, map: path, voxel, states_only };
            octomap::write(path, &occupancy).map(drop)
        }
        Format::Cloud(cloud::Format::E57) => write_stations(content, path, options),
        Format::Cloud(format) => Ok(cloud::write(path, format, &surface(content, options)?, content.origin, content.place.as_ref())?),
        Format::Tiles => write_tiles(content, path, options),
        Format::Grid => grid::write(path, &content.atlas, content.origin, path, &GridOptions::default()).map(drop),
    }
}

/// The surface of the map, which must have one.
fn surface(content: &Content, options: &MeshOptions) -> Result<Mesh> {
    let mesh = content.mesh("measured", options, false, None)?;
    if mesh.triangles.is_empty() { Err(no_surface(options)) } else { Ok(mesh) }
}

fn no_surface(options: &MeshOptions) -> Error {
    Error::new(format!("the map has no surface with {} observations or more", options.min_weight), "lower min_weight, or map more scans")
}

fn write_stations(content: &Content, path: &Path, options: &MeshOptions) -> Result<()> {
    let part = |submap: &Submap| Ok((submap.id(), content.mesh("measured", options, true, Some(submap.id()))?));
    let mut parts = content.atlas.submaps().iter().map(part).collect::<Result<Vec<_>>>()?;
    parts.retain(|(_, part)| !part.triangles.is_empty());
    if parts.is_empty() {
        return Err(no_surface(options));
    }
    Ok(cloud::write_stations(path, &content.atlas, content.origin, parts.iter().map(|(id, part)| (*id, part)))?)
}

fn write_tiles(content: &Content, folder: &Path, options: &MeshOptions) -> Result<()> {
    let voxel = content.atlas.voxel_size();
    let mut writer = TilesetWriter::create(folder, f64::from(voxel))?.with_origin(content.origin);
    let mut step = |_, _| {};
    if options.lod == 0 && !content.atlas.tsdfs().is_empty() {
        let surface = SurfaceTiles::new(&content.atlas, options.clone());
        if surface.is_empty() {
            return Err(no_surface(options));
        }
        tiles::stream(&surface, voxel, &mut writer, &mut step)?;
    } else {
        tiles::write_whole(surface(content, options)?, voxel, &mut writer, &mut step)?;
    }
    let title = folder.file_name().map_or_else(|| "map".into(), |name| name.to_string_lossy());
    tiles::finish(writer, folder, &title, content.place.as_ref()).map(drop)
}
