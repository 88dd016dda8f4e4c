//! Meshes of maps and colours of their vertices.

use crate::args::LoadArgs;
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::Path;
use voxelastic::atlas::fusion::PairAgreement;
use voxelastic::atlas::{Atlas, SubmapId};
use voxelastic::meshing::SurfaceTiles;
use voxelastic::surface::{MeshOptions, OccupancySurface, SmallComponents};
use voxelastic_eval::colour::{Ramp, Rgb, palette};
pub use voxelastic_run::export::tiles::height_range;
use voxelastic_run::map_files::{self, LoadedMap};
use voxelastic_run::surfaces::{self, MapMesh, SurfaceOptions};
use voxelastic_run::{Warnings, threads};

/// Arguments that select the surface.
#[derive(Clone, Debug, Args)]
pub struct SurfaceArgs {
    /// The surface: of the TSDF (measured; for maps without TSDF that of occupied space), or of free or occupied space
    #[arg(long, value_enum, default_value_t = Surface::Measured)]
    surface: Surface,
    /// Level of detail: 0 is full resolution, 3 has vertices eight voxels apart; smaller structures may be lost
    #[arg(long, value_name = "0..3", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=3))]
    lod: u8,
    /// Smallest number of observations of a voxel that contributes to the surface
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = observations)]
    min_weight: f32,
    /// Do not close gaps of one voxel
    #[arg(long)]
    keep_gaps: bool,
    /// Keep small components, too: pieces of a few triangles that few rays saw. Unfused surfaces and those of single submaps always have them
    #[arg(long)]
    keep_all: bool,
    /// Number of threads; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// Arguments that select one surface or those of the submaps.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct LayerArgs {
    /// Do not fuse overlapping submaps: the surfaces of all submaps on top of each other
    #[arg(long)]
    pub unfused: bool,
}

/// Kinds of surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Surface {
    /// Zero crossings of the TSDF
    Measured,
    /// Boundary of occupied voxels
    Occupied,
    /// Boundary of free space, facing inwards
    FreeHull,
    /// Boundary between free and unknown space
    Frontier,
}

fn observations(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|w| (0.0..=1000.0).contains(w)).ok_or_else(|| "must be a number from 0 to 1000".to_owned())
}

impl Default for SurfaceArgs {
    fn default() -> Self {
        Self { surface: Surface::Measured, lod: 0, min_weight: 1.0, keep_gaps: false, keep_all: false, threads: 0 }
    }
}

impl SurfaceArgs {
    /// These arguments with a level of detail of at least `lod`.
    pub fn coarser(&self, lod: u8) -> Self {
        Self { lod: self.lod.max(lod.min(3)), ..self.clone() }
    }

    /// Loads what of a map the surface is made of.
    pub fn load(&self, path: &Path, load: LoadArgs) -> anyhow::Result<LoadedMap> {
        let load = load.into();
        Ok(if self.surface == Surface::Measured { map_files::load_surfaces(path, load)? } else { map_files::load(path, load)? })
    }

    /// The surface that these arguments ask for.
    pub fn options(&self, layers: LayerArgs) -> SurfaceOptions {
        let Self { surface, lod, min_weight, keep_gaps, keep_all, .. } = *self;
        let occupancy = match surface {
            Surface::Measured => None,
            Surface::Occupied => Some(OccupancySurface::Occupied),
            Surface::FreeHull => Some(OccupancySurface::FreeHull),
            Surface::Frontier => Some(OccupancySurface::Frontier),
        };
        let mesh = MeshOptions { min_weight, lod: lod.into(), close_gaps: !keep_gaps, keep_all };
        SurfaceOptions { occupancy, mesh, unfused: layers.unfused }
    }

    /// The error for an empty surface.
    fn empty_error(&self) -> anyhow::Error {
        let remedy = "lower --min-weight, add --keep-all, or map more scans: `voxelastic info` shows what is in a map";
        Failure::new(format!("the map has no surface with {} observations or more", self.min_weight), remedy).into()
    }

    /// A thread pool.
    pub fn pool(&self) -> voxelastic_run::Result<rayon::ThreadPool> {
        threads::pool(self.threads)
    }
}

/// What vertices are coloured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Colour {
    /// Height in the map frame
    Height,
    /// Intensity of the returns, if the scans have it
    Intensity,
    /// Colours of the scans, if they have them
    Scans,
    /// The submap that a vertex belongs to
    Submap,
    /// Integration scale: log2 of the voxel edge in finest voxels
    Scale,
    /// Nothing
    None,
}

/// What was left out of a surface for lack of evidence, as `--json` has it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LeftOut {
    pub pieces: u64,
    triangles: u64,
    area_m2: f64,
}

impl LeftOut {
    /// What was left out of `mesh`; none if all of the surface was to be kept.
    pub fn of(mesh: &MapMesh) -> Option<Self> {
        mesh.small_components.map(|SmallComponents { pieces, triangles, area }| Self { pieces, triangles, area_m2: (area * 1e3).round() / 1e3 })
    }
}

/// How two submaps agree, as `--json` has it: places on their surfaces, those of them that have a partner, and how far these are apart in millimetres.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Pair {
    /// The two submaps.
    pub submaps: [SubmapId; 2],
    /// Places on the surfaces of both, in cells of 64 voxels in which the other has a surface, too.
    pub places: u64,
    /// Of these, those where the other has the same surface, up to five voxels away.
    pub matched: u64,
    /// How far apart these are, with the poses as they are.
    pub apart_mm: f64,
    /// The same after bending.
    pub left_mm: f64,
}

impl Pair {
    /// Pairs of submaps in a map with finest voxels of `voxel` metres.
    pub fn all(pairs: &[PairAgreement], voxel: f32) -> Vec<Self> {
        let millimetres = |voxels: f64| millimetres(voxels, voxel);
        let of = |pair: &PairAgreement| Self {
            submaps: pair.submaps,
            places: pair.places,
            matched: pair.matched,
            apart_mm: millimetres(pair.apart),
            left_mm: millimetres(pair.left),
        };
        pairs.iter().map(of).collect()
    }
}

fn millimetres(voxels: f64, voxel: f32) -> f64 {
    (voxels * f64::from(voxel) * 1e5).round() / 100.0
}

/// What fusing submaps for a surface found, as `--json` has it.
#[derive(Clone, Debug, Serialize)]
pub struct Fused {
    /// Voxels that one submap alone observed.
    pub alone: u64,
    /// Voxels of which a mean was taken, and the mean difference between the submaps there, millimetres.
    pub merged: u64,
    pub merged_apart_mm: f64,
    /// Voxels at which submaps contradict, and their mean difference there, millimetres.
    pub refused: u64,
    pub refused_apart_mm: f64,
    /// The same by pairs of submaps.
    pairs: Vec<Pair>,
}

impl Fused {
    /// The counts of `mesh`, of a map with finest voxels of `voxel` metres; none if submaps were not fused.
    pub fn of(mesh: &MapMesh, voxel: f32) -> Option<Self> {
        let millimetres = |voxels: f64| millimetres(voxels, voxel);
        mesh.agreement.map(|found| Self {
            pairs: Pair::all(&mesh.pairs, voxel),
            alone: found.alone,
            merged: found.merged,
            merged_apart_mm: millimetres(found.merged_apart()),
            refused: found.refused,
            refused_apart_mm: millimetres(found.refused_apart()),
        })
    }
}

/// Meshes of all submaps that have a surface, in the map frame, by submap.
pub fn submap_meshes(atlas: &Atlas, surface: &SurfaceArgs) -> anyhow::Result<Vec<(SubmapId, MapMesh)>> {
    let meshes = surfaces::by_submap(atlas, &surface.options(LayerArgs::default()), &mut Warnings::default())?;
    if meshes.is_empty() { Err(surface.empty_error()) } else { Ok(meshes) }
}

/// The surface of the whole map, in the map frame.
pub fn map_mesh(atlas: &Atlas, surface: &SurfaceArgs, layers: LayerArgs) -> anyhow::Result<MapMesh> {
    let found = surfaces::of_map(atlas, &surface.options(layers), &mut Warnings::default())?;
    if found.mesh.triangles.is_empty() { Err(surface.empty_error()) } else { Ok(found) }
}

/// The same tile by tile, for maps that have tiles.
pub fn surface_tiles(atlas: Atlas, surface: &SurfaceArgs) -> anyhow::Result<SurfaceTiles<Atlas>> {
    let tiles = surfaces::tiles(atlas, &surface.options(LayerArgs::default()), &mut Warnings::default())?;
    if tiles.is_empty() { Err(surface.empty_error()) } else { Ok(tiles) }
}

/// The default colouring: the colours of the scans if there are any that show something, else height.
pub fn default_colour(found: &MapMesh) -> Colour {
    let colours = &found.mesh.colours;
    if colours.is_empty() {
        return Colour::Height;
    }
    if is_dark(colours) {
        tracing::warn!("the colours of the scans are all nearly black: drawn by height; --colour scans draws them all the same");
        return Colour::Height;
    }
    Colour::Scans
}

/// Whether colours show nothing: drivers fill their field with zeros, or with an intensity of few steps.
fn is_dark(colours: &[Rgb]) -> bool {
    const DARK: u8 = 24;
    let light = colours.iter().filter(|colour| colour.iter().any(|v| *v >= DARK)).count();
    light * 50 < colours.len()
}

/// A colour for each vertex; none for [`Colour::None`].
///
/// # Errors
/// When vertices are to be coloured by intensities or colours that the map does not have.
pub fn colours(found: &MapMesh, by: Colour) -> anyhow::Result<Option<Vec<Rgb>>> {
    let mesh = &found.mesh;
    Ok(match by {
        Colour::None => None,
        Colour::Height => {
            let (low, high) = height_range(&mesh.positions);
            Some(mesh.positions.iter().map(|p| Ramp::Land.at((p[2] - low) / (high - low))).collect())
        }
        Colour::Intensity if mesh.intensities.is_empty() => {
            return Err(Failure::new("the map has no intensity: the scans have none", "choose another --colour, such as height").into());
        }
        Colour::Intensity => Some(mesh.intensities.iter().map(|&s| Ramp::Grey.at(f32::from(s) / 255.0)).collect()),
        Colour::Scans if mesh.colours.is_empty() => {
            return Err(Failure::new("the map has no colours: the scans have none", "choose another --colour, such as height").into());
        }
        Colour::Scans => Some(mesh.colours.clone()),
        Colour::Submap if found.submaps.is_empty() => {
            let remedy = "add --unfused for the surfaces of the submaps, or choose another --colour";
            return Err(Failure::usage("the surface is made of several submaps", remedy).into());
        }
        Colour::Submap => Some(found.submaps.iter().map(|&id| palette(id as usize)).collect()),
        Colour::Scale => Some(mesh.scales.iter().map(|&s| Ramp::Violet.at(1.0 - f32::from(s) / 3.0)).collect()),
    })
}

#[cfg(test)]
mod tests {
    use super::is_dark;

    #[test]
    fn colours_that_show_nothing_are_dark() {
        let of = |light: usize| -> Vec<[u8; 3]> { (0..1000).map(|k| if k < light { [0, 90, 10] } else { [0, 0, (k % 20) as u8] }).collect() };
        assert!(is_dark(&of(10)) && !is_dark(&of(30)), "a lamp at night is no picture, a lit road is");
    }
}
