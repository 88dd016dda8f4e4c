//! The measured object: mesh or occupied voxels of a map, or a mesh or cloud from a file.

use super::args::{EvalArgs, Field};
use super::surface::Surface;
use crate::failure::Failure;
use crate::meshing::{LayerArgs, map_mesh};
use rayon::prelude::*;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::{State, state_of};
use voxelastic::octree::{BLOCK_EDGE, NONE, block_coords, voxel_coords};
use voxelastic::query::AtlasQuery;
use voxelastic_run::map_files::{self, LoadedMap};

/// A map, or a surface from a file.
pub enum Measured {
    /// A map.
    Map(Box<LoadedMap>),
    /// A mesh or cloud.
    File(Surface),
}

impl Measured {
    /// Reads it.
    pub fn open(args: &EvalArgs) -> anyhow::Result<Self> {
        let path = &args.map;
        if !path.exists() {
            return Err(Failure::new(format!("{}: no such file or folder", path.display()), "check the path").into());
        }
        if path.is_dir() {
            let map = map_files::load(path, args.load.into())?;
            if !map.origin.is_zero() {
                let what = format!("{}: the map has an origin ({} m), and truths are compared in single precision", path.display(), map.origin);
                let remedy = "measure it with held-out scans (`voxelastic heldout`), or map and measure with an offset taken off poses and truth";
                return Err(Failure::new(what, remedy).into());
            }
            return Ok(Self::Map(Box::new(map)));
        }
        if args.field.is_some() || args.unfused {
            let what = format!("{}: this is not a map, so it has no fields and no submaps", path.display());
            return Err(Failure::usage(what, "leave out --field and --unfused").into());
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

    /// The surface to measure. Can be called once: the surface of a file is moved out.
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

/// Whether a map has occupancy.
pub fn has_occupancy(atlas: &Atlas) -> bool {
    atlas.submaps().iter().any(|s| !s.occupancy().is_empty())
}

/// The field to measure.
fn field(map: &LoadedMap, args: &EvalArgs) -> anyhow::Result<Field> {
    let has_tsdf = map.atlas.submaps().iter().any(|s| !s.tsdf().is_empty());
    let missing = match args.field.unwrap_or(if has_tsdf { Field::Tsdf } else { Field::Occupancy }) {
        Field::Tsdf if !has_tsdf => "tsdf",
        Field::Occupancy if !has_occupancy(&map.atlas) => "occupancy",
        present => return Ok(present),
    };
    let what = format!("{}: the map has no {missing} field; it was built with field = {}", args.map.display(), map.settings.field.name());
    Err(Failure::new(what, format!("map the data with --field {missing} or --field both, or choose another --field here")).into())
}

/// Vertices of the mesh of the whole map, in which submaps are fused (paper Sec. V-A), or of the meshes of the submaps.
fn vertices(map: &LoadedMap, args: &EvalArgs) -> anyhow::Result<Surface> {
    let mesh = map_mesh(&map.atlas, &args.surface, LayerArgs { unfused: args.unfused })?;
    Ok(Surface { what: "vertices", positions: mesh.mesh.positions, triangles: mesh.mesh.triangles })
}

/// Centres of the occupied voxels of the map, on one grid in the map frame: occupied in a submap and in the query over all submaps.
fn occupied(map: &LoadedMap) -> Vec<[f32; 3]> {
    let voxel = f64::from(map.settings.voxel_size);
    let mut cells: Vec<[i32; 3]> = map.atlas.submaps().par_iter().flat_map_iter(|submap| occupied_cells(submap, voxel)).collect();
    cells.par_sort_unstable();
    cells.dedup();
    let query = AtlasQuery::new(&map.atlas);
    let centre = |cell: [i32; 3]| cell.map(|c| (f64::from(c) + 0.5) * voxel);
    cells.into_par_iter().map(centre).filter(|c| query.state(*c) == State::Occupied).map(|c| c.map(|c| c as f32)).collect()
}

/// Cells of the grid in the map frame that contain the centre of an occupied finest voxel of `submap`.
fn occupied_cells(submap: &Submap, voxel: f64) -> Vec<[i32; 3]> {
    let field = submap.occupancy();
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
                let at = submap.t_map_submap() * nalgebra::Point3::from(at);
                cells.push(<[f64; 3]>::from(at.coords).map(|c| (c / voxel).floor() as i32));
            }
        }
    });
    cells
}
