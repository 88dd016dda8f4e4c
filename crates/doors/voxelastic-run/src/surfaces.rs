//! The surfaces of a map, in the map frame: one of all submaps, or those of the submaps on top of each other.

use crate::{Error, Result, Warnings, precision};
use voxelastic::atlas::fusion::{Agreement, PairAgreement};
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::geometry::Rigid;
use voxelastic::meshing::{FusedMesh, SurfaceTiles};
use voxelastic::surface::{Mesh, MeshOptions, OccupancySurface, SmallComponents, extract, extract_occupancy, extract_onto};

/// What the surface of a map is made of, and how.
#[derive(Clone, Debug, Default)]
pub struct SurfaceOptions {
    /// The surface of occupancy to extract; none for that of the TSDF, or of occupied space in submaps without TSDF.
    pub occupancy: Option<OccupancySurface>,
    /// Level of detail, least number of observations, gaps and small components.
    pub mesh: MeshOptions,
    /// Do not fuse overlapping submaps.
    pub unfused: bool,
}

/// The mesh of a submap or of a map, in the map frame.
#[derive(Debug, Default)]
pub struct MapMesh {
    /// The surface, metres.
    pub mesh: Mesh,
    /// Submap of each vertex; empty if submaps were fused.
    pub submaps: Vec<SubmapId>,
    /// How well the submaps agree, if they were fused.
    pub agreement: Option<Agreement>,
    /// The same by pairs of submaps.
    pub pairs: Vec<PairAgreement>,
    /// What was left out for lack of evidence, if anything could be.
    pub small_components: Option<SmallComponents>,
}

impl SurfaceOptions {
    /// The surface of a submap, in the submap frame.
    pub fn extract(&self, submap: &Submap) -> Mesh {
        match self.occupancy_of(submap) {
            Some(kind) => extract_occupancy(submap.occupancy(), submap.voxel_size(), kind, self.mesh.lod),
            None => extract(submap.tsdf(), submap.voxel_size(), &self.mesh),
        }
    }

    /// Appends the surface of a submap to `mesh`, in the map frame.
    fn extract_onto(&self, mesh: &mut Mesh, submap: &Submap) {
        let (t, voxel) = (Rigid::from(&submap.t_map_submap()), submap.voxel_size());
        match self.occupancy_of(submap) {
            Some(kind) => mesh.append(&extract_occupancy(submap.occupancy(), voxel, kind, self.mesh.lod), &t),
            None => extract_onto(mesh, submap.tsdf(), voxel, &self.mesh, Some(&t)),
        }
    }

    /// The surface of occupancy to extract of a submap; none for that of the TSDF.
    fn occupancy_of(&self, submap: &Submap) -> Option<OccupancySurface> {
        self.occupancy.or_else(|| submap.tsdf().is_empty().then_some(OccupancySurface::Occupied))
    }

    /// Whether the surface is that of the TSDFs of all submaps that have one, fused.
    fn is_fused(&self, atlas: &Atlas) -> bool {
        let is_measured = atlas.submaps().iter().all(|submap| submap.tsdf().is_empty() || self.occupancy_of(submap).is_none());
        !self.unfused && is_measured && !atlas.tsdfs().is_empty()
    }

    /// Whether the surface of the map can be made tile by tile: at full detail, one of all submaps, of their TSDFs.
    pub fn has_tiles(&self, atlas: &Atlas) -> bool {
        self.mesh.lod == 0 && self.is_fused(atlas)
    }
}

/// The surface of the whole map: overlapping submaps are fused, and a place has one surface. Surfaces of occupancy are those of the submaps. It may be empty.
///
/// # Errors
/// When coordinates in single precision have steps larger than a voxel.
pub fn of_map(atlas: &Atlas, options: &SurfaceOptions, warnings: &mut Warnings) -> Result<MapMesh> {
    precision::check(atlas, atlas.voxel_size(), warnings)?;
    if !options.is_fused(atlas) {
        return Ok(unfused(atlas, options));
    }
    let FusedMesh { mesh, agreement, pairs, small_components, .. } = atlas.fused_mesh(&options.mesh);
    let fields = atlas.tsdfs().len();
    let only = atlas.submaps().iter().find(|submap| fields == 1 && !submap.tsdf().is_empty());
    let submaps = only.map_or_else(Vec::new, |submap| vec![submap.id(); mesh.positions.len()]);
    Ok(MapMesh {
        mesh,
        submaps,
        agreement: (fields > 1).then_some(agreement),
        pairs,
        small_components: (!options.mesh.keep_all).then_some(small_components),
    })
}

/// The same tile by tile, for maps that [have tiles](SurfaceOptions::has_tiles). The atlas is dropped when its submaps are fused.
///
/// # Errors
/// As for [`of_map`].
pub fn tiles(atlas: Atlas, options: &SurfaceOptions, warnings: &mut Warnings) -> Result<SurfaceTiles<Atlas>> {
    precision::check(&atlas, atlas.voxel_size(), warnings)?;
    Ok(SurfaceTiles::new(atlas, options.mesh.clone()))
}

/// The surfaces of all submaps that have one, by submap.
///
/// # Errors
/// As for [`of_map`].
pub fn by_submap(atlas: &Atlas, options: &SurfaceOptions, warnings: &mut Warnings) -> Result<Vec<(SubmapId, MapMesh)>> {
    precision::check(atlas, atlas.voxel_size(), warnings)?;
    let of = |submap: &Submap| {
        let mut mesh = options.extract(submap);
        mesh.transform(&Rigid::from(&submap.t_map_submap()));
        let submaps = vec![submap.id(); mesh.positions.len()];
        (submap.id(), MapMesh { mesh, submaps, ..MapMesh::default() })
    };
    Ok(atlas.submaps().iter().map(of).filter(|(_, found)| !found.mesh.triangles.is_empty()).collect())
}

/// The surfaces of all submaps on top of each other.
fn unfused(atlas: &Atlas, options: &SurfaceOptions) -> MapMesh {
    let mut all = MapMesh::default();
    for submap in atlas.submaps() {
        options.extract_onto(&mut all.mesh, submap);
        all.submaps.resize(all.mesh.positions.len(), submap.id());
    }
    all
}

/// Those surfaces, of which there must be one, for comparing places.
///
/// # Errors
/// When there is none.
pub fn of_submaps(atlas: &Atlas, options: &SurfaceOptions) -> Result<Mesh> {
    let mesh = unfused(atlas, options).mesh;
    if mesh.triangles.is_empty() {
        return Err(Error::new("the map has no surface", "map more scans: `voxelastic info` shows what is in a map"));
    }
    Ok(mesh)
}
