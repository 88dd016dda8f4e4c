//! A surface to compare: vertices of a mesh, points of a cloud, or occupied voxels.

use std::path::Path;
use voxelastic::Cloud;
use voxelastic_eval::MeshView;
use voxelastic_eval::metrics::Map;
use voxelastic_io::clouds::{self, CloudFormat};
use voxelastic_io::ply;

/// Points of a surface, with triangles if it is a mesh.
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
    /// As input of the evaluation.
    pub fn as_map(&self) -> voxelastic_eval::Result<Map<'_>> {
        if self.triangles.is_empty() {
            return Ok(Map::Points(&self.positions));
        }
        Ok(Map::Mesh(MeshView::new(&self.positions, &self.triangles)?))
    }

    /// Reads a mesh or a cloud; points that are not returns are left out.
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
