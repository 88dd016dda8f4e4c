//! What is measured: a map's mesh or occupied voxels, or somebody's mesh or cloud.

use super::{EvalArgs, Field};
use crate::failure::Failure;
use crate::map_files::{self, LoadedMap};
use crate::meshing::map_mesh;
use rayon::prelude::*;
use std::path::Path;
use voxelastic::Cloud;
use voxelastic::atlas::fusion::{FusionSettings, fuse};
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::{State, state_of};
use voxelastic::octree::{BLOCK_EDGE, NONE, block_coords, voxel_coords};
use voxelastic::query::AtlasQuery;
use voxelastic_eval::MeshView;
use voxelastic_eval::metrics::Map;
use voxelastic_io::clouds::{self, CloudFormat};
use voxelastic_io::ply;

/// Points of a surface, and its triangles where it has some.
#[derive(Default)]
pub struct Surface {
    /// `vertices`, `points` or `voxels`.
    pub what: &'static str,
    /// Metres, map frame.
    pub positions: Vec<[f32; 3]>,
    /// Indices of positions; empty for a cloud.
    pub triangles: Vec<[u32; 3]>,
}

impl Surface {
    /// As the evaluation wants it.
    pub fn as_map(&self) -> voxelastic_eval::Result<Map<'_>> {
        if self.triangles.is_empty() {
            return Ok(Map::Points(&self.positions));
        }
        Ok(Map::Mesh(MeshView::new(&self.positions, &self.triangles)?))
    }

    /// Reads a mesh or a cloud; points that are not finite or no returns are left out.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        if CloudFormat::of(path) == Some(CloudFormat::Ply) {
            let mesh = ply::read_mesh(path)?;
            if !mesh.triangles.is_empty() {
                return Ok(Self { what: "vertices", positions: mesh.positions, triangles: mesh.triangles });
            }
        }
        let mut positions = clouds::read(path)?.cloud.points;
        positions.retain(Cloud::is_return);
        Ok(Self { what: "points", positions, triangles: Vec::new() })
    }
}

/// What was named on the command line.
pub enum Measured {
    /// A map.
    Map(LoadedMap),
    /// A mesh or cloud.
    File(Surface),
}

impl Measured {
    /// Reads it.
    pub fn open(args: &EvalArgs) -> anyhow::Result<Self> {
        let path = &args.map;
        if !path.exists() {
            return Err(Failure::new(format!("{}: there is nothing of this name", path.display()), "check the path").into());
        }
        if path.is_dir() {
            return Ok(Self::Map(map_files::load(path)?));
        }
        if args.field.is_some() || args.no_fuse {
            let what = format!("{}: not a map, so it has no fields and no submaps", path.display());
            return Err(Failure::usage(what, "leave out --field and --no-fuse").into());
        }
        Ok(Self::File(Surface::read(path)?))
    }

    /// The map, if it is one.
    pub fn map(&self) -> Option<&LoadedMap> {
        match self {
            Self::Map(map) => Some(map),
            Self::File(_) => None,
        }
    }

    /// The surface to be measured. It is handed out once: fusing takes the TSDF apart to spare memory.
    pub fn surface(&mut self, args: &EvalArgs) -> anyhow::Result<Surface> {
        match self {
            Self::File(surface) => Ok(std::mem::take(surface)),
            Self::Map(map) => match field(map, args)? {
                Field::Tsdf => vertices(map, args),
                Field::Occupancy => Ok(Surface { what: "voxels", positions: occupied(map), triangles: Vec::new() }),
            },
        }
    }
}

/// Whether a map knows free and occupied space.
pub fn has_occupancy(atlas: &Atlas) -> bool {
    atlas.submaps().iter().any(|s| !s.occupancy.is_empty())
}

/// The field to be measured, which the map must have.
fn field(map: &LoadedMap, args: &EvalArgs) -> anyhow::Result<Field> {
    let has_tsdf = map.atlas.submaps().iter().any(|s| !s.tsdf.is_empty());
    let missing = match args.field.unwrap_or(if has_tsdf { Field::Tsdf } else { Field::Occupancy }) {
        Field::Tsdf if !has_tsdf => "tsdf",
        Field::Occupancy if !has_occupancy(&map.atlas) => "occupancy",
        there => return Ok(there),
    };
    let what = format!("{}: the map has no {missing} field; it was made with field = {}", args.map.display(), map.settings.field.name());
    Err(Failure::new(what, format!("map the data with --field {missing} or --field both, or choose another --field here")).into())
}

/// The mesh, of all submaps fused into one (paper Sec. V-A) or as each of them has it.
fn vertices(map: &mut LoadedMap, args: &EvalArgs) -> anyhow::Result<Surface> {
    let voxel = map.settings.voxel;
    let mesh = if args.no_fuse || map.atlas.submaps().len() < 2 {
        map_mesh(&map.atlas, voxel, &args.surface)?
    } else {
        tracing::info!("fusing {} submaps", map.atlas.submaps().len());
        map_mesh(&Atlas::from_submaps(vec![fused(map)]), voxel, &args.surface)?
    };
    Ok(Surface { what: "vertices", positions: mesh.mesh.positions, triangles: mesh.mesh.triangles })
}

/// All TSDFs in the first submap's frame; the map keeps its occupancy only.
fn fused(map: &mut LoadedMap) -> Submap {
    let settings = FusionSettings::from(&map.settings);
    let mut parts = map.atlas.submaps_mut().iter_mut().map(|submap| {
        let mut part = Submap::new(submap.id, submap.t_map_submap);
        part.tsdf = std::mem::take(&mut submap.tsdf);
        part
    });
    let mut target = parts.next().unwrap_or_else(|| Submap::new(0, voxelastic::Pose::identity()));
    for part in parts {
        let t_target_part = target.t_map_submap.inv_mul(&part.t_map_submap);
        fuse(&mut target, &part, &t_target_part, &settings);
    }
    target
}

/// Centres of the occupied voxels of the whole map, on one grid of the map frame: those that a submap holds to be occupied and that the map as
/// a whole does not hold to be anything else.
fn occupied(map: &LoadedMap) -> Vec<[f32; 3]> {
    let voxel = f64::from(map.settings.voxel);
    let mut cells: Vec<[i32; 3]> = map.atlas.submaps().par_iter().flat_map_iter(|submap| occupied_cells(submap, voxel)).collect();
    cells.par_sort_unstable();
    cells.dedup();
    let query = AtlasQuery::new(&map.atlas, map.settings.voxel);
    let centre = |cell: [i32; 3]| cell.map(|c| (f64::from(c) + 0.5) * voxel);
    cells.into_par_iter().map(centre).filter(|c| query.state(*c) == State::Occupied).map(|c| c.map(|c| c as f32)).collect()
}

/// Cells of the map frame's grid that hold the centre of a finest voxel that `submap` holds to be occupied.
fn occupied_cells(submap: &Submap, voxel: f64) -> Vec<[i32; 3]> {
    let field = &submap.occupancy;
    let mut cells = Vec::new();
    field.tree().for_each(|_, level, octant| {
        if level > 0 || octant.link == NONE {
            return;
        }
        let block = field.block(octant.link);
        let (corner, scale) = (block_coords(block.key).map(|c| c * BLOCK_EDGE as i32), usize::from(block.scale));
        for (i, _) in field.values(block).iter().enumerate().filter(|(_, v)| state_of(**v) == State::Occupied) {
            let low = voxel_coords(i, scale);
            let edge = 1usize << scale;
            for k in 0..edge * edge * edge {
                let step = [k % edge, k / edge % edge, k / (edge * edge)];
                let at = std::array::from_fn::<_, 3, _>(|a| (f64::from(corner[a]) + (low[a] * edge + step[a]) as f64 + 0.5) * voxel);
                let at = submap.t_map_submap * nalgebra::Point3::from(at);
                cells.push(<[f64; 3]>::from(at.coords).map(|c| (c / voxel).floor() as i32));
            }
        }
    });
    cells
}
