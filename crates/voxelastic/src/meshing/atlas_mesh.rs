//! Meshes of an atlas and of its submaps.

use crate::atlas::{Atlas, Submap};
use crate::geometry::Rigid;
use crate::surface::{Mesh, MeshOptions, extract, extract_onto};

impl Atlas {
    /// The surfaces of all submaps at their current root poses as one mesh, in metres of the map frame. Where submaps overlap, each
    /// contributes its own surface.
    ///
    /// ```
    /// use voxelastic::atlas::Atlas;
    /// use voxelastic::surface::MeshOptions;
    /// let mesh = Atlas::new(0.065).mesh(&MeshOptions::default());
    /// assert!(mesh.triangles.is_empty());
    /// ```
    pub fn mesh(&self, options: &MeshOptions) -> Mesh {
        let mut mesh = Mesh::default();
        let merging = self.merging().map(|merging| (merging.submap, merging.t_map_submap));
        for (submap, t_map_submap) in self.submaps().iter().map(|submap| (submap, submap.t_map_submap)).chain(merging) {
            extract_onto(&mut mesh, &submap.tsdf, submap.voxel_size, options, Some(&Rigid::from(&t_map_submap)));
        }
        mesh
    }
}

impl Submap {
    /// The submap's surface in metres of the submap frame.
    pub fn mesh(&self, options: &MeshOptions) -> Mesh {
        extract(&self.tsdf, self.voxel_size, options)
    }
}
