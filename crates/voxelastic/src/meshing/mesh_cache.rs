//! Cache of submap meshes in submap frames: a pose correction changes a matrix, and only submaps whose fields changed are extracted again.

use crate::atlas::{Submap, SubmapId};
use crate::surface::{Mesh, MeshOptions};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Meshes of submaps, each in the submap frame, with the revision of the fields from which they were extracted.
#[derive(Clone, Debug)]
pub struct MeshCache {
    options: MeshOptions,
    meshes: BTreeMap<SubmapId, (u64, Arc<Mesh>)>,
}

impl MeshCache {
    /// An empty cache.
    pub fn new(options: MeshOptions) -> Self {
        Self { options, meshes: BTreeMap::new() }
    }

    /// The surface of `submap` in metres of the submap frame: from the cache unless the submap's [`revision`](Submap::revision) has changed.
    pub fn mesh(&mut self, submap: &Submap) -> Arc<Mesh> {
        match self.meshes.get(&submap.id) {
            Some((revision, mesh)) if *revision == submap.revision => Arc::clone(mesh),
            _ => {
                let mesh = Arc::new(submap.mesh(&self.options));
                self.meshes.insert(submap.id, (submap.revision, Arc::clone(&mesh)));
                mesh
            }
        }
    }

    /// Removes the meshes of submaps that are not among `submaps`.
    pub fn retain<'a>(&mut self, submaps: impl IntoIterator<Item = &'a Submap>) {
        let ids: std::collections::BTreeSet<SubmapId> = submaps.into_iter().map(|s| s.id).collect();
        self.meshes.retain(|id, _| ids.contains(id));
    }

    /// Number of meshes.
    pub fn len(&self) -> usize {
        self.meshes.len()
    }

    /// Whether there are no meshes.
    pub fn is_empty(&self) -> bool {
        self.meshes.is_empty()
    }
}
