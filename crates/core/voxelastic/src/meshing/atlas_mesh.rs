//! Meshes of an atlas and of its submaps.

use crate::atlas::fusion::{Agreement, FusedTsdf, PairAgreement};
use crate::atlas::{Atlas, Submap};
use crate::geometry::Rigid;
use crate::surface::{Mesh, MeshOptions, SmallComponents, extract, extract_joined, extract_onto};

/// log2 of the edge of the tiles in blocks that the whole surface is made in. The mesh does not depend on it.
const TILE_SHIFT: u32 = 4;

/// The surface of an atlas, how well its submaps agree, and what was left out.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct FusedMesh {
    /// The surface in metres of the map frame.
    pub mesh: Mesh,
    /// What was merged and what contradicts; zero if a single submap has a TSDF.
    pub agreement: Agreement,
    /// The same by pairs of [`tsdfs`](Atlas::tsdfs) that have surfaces in the same places.
    pub pairs: Vec<PairAgreement>,
    /// Pieces that were left out because they have too little evidence.
    pub small_components: SmallComponents,
}

impl Atlas {
    /// The surface of the map as one mesh, in metres of the map frame: overlapping submaps are fused first (paper Sec. V-A), so that a place
    /// has one surface however many submaps saw it. The submaps stay as they are.
    ///
    /// Small components are left out unless [`keep_all`](MeshOptions::keep_all) is set: connected pieces with too little evidence, which is the sum of the
    /// observations at their vertices. So a piece stays that is large, or small and was seen often.
    ///
    /// ```
    /// use voxelastic::atlas::Atlas;
    /// use voxelastic::surface::MeshOptions;
    /// let mesh = Atlas::new(0.065).mesh(&MeshOptions::default());
    /// assert!(mesh.triangles.is_empty());
    /// ```
    pub fn mesh(&self, options: &MeshOptions) -> Mesh {
        self.fused_mesh(options).mesh
    }

    /// The same as [`mesh`](Self::mesh), with how well the submaps agree. A single submap with a TSDF is not resampled.
    pub fn fused_mesh(&self, options: &MeshOptions) -> FusedMesh {
        let mut one = FusedMesh::default();
        match self.tsdfs()[..] {
            [] => {}
            [(field, pose)] => {
                (one.mesh, one.small_components) = extract_joined(field, self.voxel_size(), options, TILE_SHIFT);
                one.mesh.transform(&Rigid::from(&pose));
            }
            _ => {
                let fused = FusedTsdf::new(self);
                (one.mesh, one.small_components) = extract_joined(&fused.field, self.voxel_size(), options, TILE_SHIFT);
                (one.agreement, one.pairs) = (fused.agreement(), fused.pairs);
            }
        }
        one
    }

    /// The surfaces of all submaps at their current root poses on top of each other, in metres of the map frame: where submaps overlap, each
    /// contributes its own.
    pub fn unfused_mesh(&self, options: &MeshOptions) -> Mesh {
        let mut mesh = Mesh::default();
        for (field, t_map_submap) in self.tsdfs() {
            extract_onto(&mut mesh, field, self.voxel_size(), options, Some(&Rigid::from(&t_map_submap)));
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
