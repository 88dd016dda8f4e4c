//! Surfaces kept in their submap's frame: a pose correction moves them with a matrix, and only a submap that changed is extracted anew.

use super::{Submap, SubmapId};
use crate::surface::{Mesh, MeshOptions, extract};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The meshes of an atlas' submaps, each in its submap's frame.
#[derive(Clone, Debug)]
pub struct MeshCache {
    voxel: f32,
    options: MeshOptions,
    meshes: BTreeMap<SubmapId, (u64, Arc<Mesh>)>,
}

impl MeshCache {
    /// An empty cache for submaps with finest voxels of `voxel` metres.
    pub fn new(voxel: f32, options: MeshOptions) -> Self {
        Self { voxel, options, meshes: BTreeMap::new() }
    }

    /// The surface of `submap`, in metres of its frame: from the cache unless the submap's [`revision`](Submap::revision) has changed.
    pub fn mesh(&mut self, submap: &Submap) -> Arc<Mesh> {
        match self.meshes.get(&submap.id) {
            Some((revision, mesh)) if *revision == submap.revision => Arc::clone(mesh),
            _ => {
                let mesh = Arc::new(extract(&submap.tsdf, self.voxel, &self.options));
                self.meshes.insert(submap.id, (submap.revision, Arc::clone(&mesh)));
                mesh
            }
        }
    }

    /// Forgets the meshes of submaps that are not among `living`.
    pub fn keep<'a>(&mut self, living: impl IntoIterator<Item = &'a Submap>) {
        let living: std::collections::BTreeSet<SubmapId> = living.into_iter().map(|s| s.id).collect();
        self.meshes.retain(|id, _| living.contains(id));
    }

    /// Meshes held.
    pub fn len(&self) -> usize {
        self.meshes.len()
    }

    /// Whether no mesh is held.
    pub fn is_empty(&self) -> bool {
        self.meshes.is_empty()
    }
}
