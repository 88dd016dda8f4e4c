//! Meshes of whole maps, and what their vertices are coloured by.

use crate::failure::Failure;
use clap::{Args, ValueEnum};
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::geometry::Rigid;
use voxelastic::surface::{Mesh, MeshOptions, OccupancySurface, extract, extract_occupancy, extract_onto};
use voxelastic_eval::colour::{Ramp, Rgb, palette};

/// What surfaces are extracted.
#[derive(Clone, Debug, Args)]
pub struct SurfaceArgs {
    /// Which surface: measured (of the TSDF; maps without one show what is occupied), or one of free and occupied space
    #[arg(long, value_enum, default_value_t = Surface::Measured)]
    surface: Surface,
    /// Level of detail: 0 for all detail, up to 3 for vertices eight voxels apart; what is smaller than that may vanish
    #[arg(long, value_name = "0..3", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=3))]
    lod: u8,
    /// Observations that a voxel needs before it takes part in the surface
    #[arg(long, value_name = "N", default_value_t = 1.0, value_parser = observations)]
    min_weight: f32,
    /// Leave gaps of one voxel open instead of closing them from both sides
    #[arg(long)]
    keep_gaps: bool,
    /// Threads to use; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// Kinds of surfaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Surface {
    /// Zero crossings of the TSDF
    Measured,
    /// Skin of occupied voxels
    Occupied,
    /// Hull of free space, seen from inside
    FreeHull,
    /// Where free space meets the unknown
    Frontier,
}

fn observations(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|w| (0.0..=1000.0).contains(w)).ok_or_else(|| "must be a number from 0 to 1000".to_owned())
}

impl Default for SurfaceArgs {
    fn default() -> Self {
        Self { surface: Surface::Measured, lod: 0, min_weight: 1.0, keep_gaps: false, threads: 0 }
    }
}

impl SurfaceArgs {
    /// The same with at least this level of detail.
    pub fn coarser(&self, lod: u8) -> Self {
        Self { lod: self.lod.max(lod.min(3)), ..self.clone() }
    }

    fn options(&self) -> MeshOptions {
        MeshOptions { min_weight: self.min_weight, lod: usize::from(self.lod), close_gaps: !self.keep_gaps }
    }

    /// The surface of a submap in its frame.
    pub fn extract(&self, submap: &Submap, voxel: f32) -> Mesh {
        match self.occupancy(submap) {
            Some(kind) => extract_occupancy(&submap.occupancy, voxel, kind, self.lod.into()),
            None => extract(&submap.tsdf, voxel, &self.options()),
        }
    }

    /// Appends the surface of a submap to `mesh`, in the map frame.
    pub fn extract_onto(&self, mesh: &mut Mesh, submap: &Submap, voxel: f32) {
        let t = Rigid::from(&submap.t_map_submap);
        match self.occupancy(submap) {
            Some(kind) => mesh.append(&extract_occupancy(&submap.occupancy, voxel, kind, self.lod.into()), &t),
            None => extract_onto(mesh, &submap.tsdf, voxel, &self.options(), Some(&t)),
        }
    }

    /// Which surface of the submap's occupancy is wanted; none for that of its TSDF.
    fn occupancy(&self, submap: &Submap) -> Option<OccupancySurface> {
        match self.surface {
            Surface::Measured => submap.tsdf.is_empty().then_some(OccupancySurface::Occupied),
            Surface::Occupied => Some(OccupancySurface::Occupied),
            Surface::FreeHull => Some(OccupancySurface::FreeHull),
            Surface::Frontier => Some(OccupancySurface::Frontier),
        }
    }

    /// Why there is no mesh.
    fn nothing(&self) -> anyhow::Error {
        let remedy = "lower --min-weight, or map more scans: `voxelastic info` shows what is in a map";
        Failure::new(format!("the map has no surface seen {} times or more", self.min_weight), remedy).into()
    }

    /// The pool to work in.
    pub fn pool(&self) -> anyhow::Result<rayon::ThreadPool> {
        pool(self.threads)
    }
}

/// A pool of `threads` threads, 0 for all cores.
pub fn pool(threads: usize) -> anyhow::Result<rayon::ThreadPool> {
    let built = rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("worker {i}")).build();
    built.map_err(|e| Failure::new(format!("cannot start {threads} threads: {e}"), "ask for fewer with --threads").into())
}

/// What vertices are coloured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Colour {
    /// Height in the map frame
    Height,
    /// Strength of the return, where the scans have it
    Intensity,
    /// The scans' own colours, where they have them
    Scans,
    /// The submap that a vertex belongs to
    Submap,
    /// The integration scale: how coarse the map is there
    Scale,
    /// Nothing
    None,
}

/// The mesh of a submap or of a map, in the map frame.
#[derive(Debug, Default)]
pub struct MapMesh {
    /// The surface, metres.
    pub mesh: Mesh,
    /// Submap of each vertex.
    pub submaps: Vec<SubmapId>,
}

/// Meshes of all submaps that have a surface, in the map frame, by submap.
pub fn submap_meshes(atlas: &Atlas, voxel: f32, surface: &SurfaceArgs) -> anyhow::Result<Vec<(SubmapId, MapMesh)>> {
    let mut meshes = Vec::new();
    for submap in atlas.submaps() {
        let mut mesh = surface.extract(submap, voxel);
        if !mesh.triangles.is_empty() {
            mesh.transform(&Rigid::from(&submap.t_map_submap));
            let submaps = vec![submap.id; mesh.positions.len()];
            meshes.push((submap.id, MapMesh { mesh, submaps }));
        }
    }
    if meshes.is_empty() {
        return Err(surface.nothing());
    }
    Ok(meshes)
}

/// The mesh of the whole map, in the map frame.
pub fn map_mesh(atlas: &Atlas, voxel: f32, surface: &SurfaceArgs) -> anyhow::Result<MapMesh> {
    let mut all = MapMesh::default();
    for submap in atlas.submaps() {
        surface.extract_onto(&mut all.mesh, submap, voxel);
        all.submaps.resize(all.mesh.positions.len(), submap.id);
    }
    if all.mesh.triangles.is_empty() {
        return Err(surface.nothing());
    }
    Ok(all)
}

/// Heights between which the height colours run, metres: the 1st and the 99th percentile, so that a stray vertex changes nothing.
pub fn height_range(positions: &[[f32; 3]]) -> (f32, f32) {
    let mut heights: Vec<f32> = positions.iter().map(|p| p[2]).filter(|z| z.is_finite()).collect();
    heights.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| heights.get(((heights.len().saturating_sub(1)) as f64 * share).round() as usize).copied().unwrap_or(0.0);
    let (low, high) = (at(0.01), at(0.99));
    (low, high.max(low + 0.01))
}

impl MapMesh {
    /// What to colour by where nobody says: the scans' own colours if there are any, else height.
    pub fn usual_colour(&self) -> Colour {
        if self.mesh.colours.is_empty() { Colour::Height } else { Colour::Scans }
    }

    /// A colour for each vertex; none for [`Colour::None`].
    ///
    /// # Errors
    /// When the map has no intensity, or no colours, and is to be coloured by them.
    pub fn colours(&self, by: Colour) -> anyhow::Result<Option<Vec<Rgb>>> {
        let mesh = &self.mesh;
        Ok(match by {
            Colour::None => None,
            Colour::Height => {
                let (low, high) = height_range(&mesh.positions);
                Some(mesh.positions.iter().map(|p| Ramp::Land.at((p[2] - low) / (high - low))).collect())
            }
            Colour::Intensity if mesh.shades.is_empty() => {
                return Err(Failure::new("the map has no intensity: its scans had none", "choose another --colour, such as height").into());
            }
            Colour::Intensity => Some(mesh.shades.iter().map(|&s| Ramp::Grey.at(f32::from(s) / 255.0)).collect()),
            Colour::Scans if mesh.colours.is_empty() => {
                return Err(Failure::new("the map has no colours: its scans had none", "choose another --colour, such as height").into());
            }
            Colour::Scans => Some(mesh.colours.clone()),
            Colour::Submap => Some(self.submaps.iter().map(|&id| palette(id as usize)).collect()),
            Colour::Scale => Some(mesh.scales.iter().map(|&s| Ramp::Violet.at(1.0 - f32::from(s) / 3.0)).collect()),
        })
    }
}
