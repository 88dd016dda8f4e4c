//! The surfaces of a map, and how they agree if the submaps lie elsewhere.

use crate::editing::graph::now;
use crate::editing::pair_fit::PairFit;
use crate::editing::state::State;
use crate::error::Result;
use crate::surfaces::SurfaceOptions;
use rayon::prelude::*;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::geometry::Rigid;
use voxelastic::surface::Mesh;
use voxelastic::surface::MeshOptions;

/// The submaps of a map, to which poses are given that are tried.
pub struct Survey {
    voxel: f32,
    submaps: Vec<Submap>,
}

impl Survey {
    /// Reads the submaps of a map.
    pub fn of(state: &State) -> Result<Self> {
        let submaps = state.entries.par_iter().map(|entry| state.submap(entry.id)).collect::<Result<Vec<_>>>()?;
        Ok(Self { voxel: submaps.first().map_or(1.0, Submap::voxel_size), submaps })
    }

    /// Edge of the finest voxel, metres.
    pub fn voxel(&self) -> f64 {
        f64::from(self.voxel)
    }

    /// How the pairs of submaps agree where a state has them. The fields are those of the state that was read.
    pub fn pairs(&mut self, state: &State) -> Vec<PairFit> {
        let placed = std::mem::take(&mut self.submaps).into_iter().map(|mut submap| {
            let Some(entry) = state.entries.iter().find(|entry| entry.id == submap.id()) else { return submap };
            submap.set_pose(entry.t_map_submap);
            let corrected = if entry.corrected.is_empty() { Vec::new() } else { now(entry).map(|(_, pose)| pose).collect() };
            submap.with_corrected(corrected)
        });
        let atlas = Atlas::from_submaps(self.voxel, placed.collect());
        let pairs = atlas.pair_agreement().iter().map(|pair| PairFit::of(pair, self.voxel)).collect();
        self.submaps = atlas.into_submaps();
        pairs
    }

    /// The surfaces of the submaps in the map as it was read, small pieces too.
    pub fn surfaces(&self) -> Vec<(SubmapId, Mesh)> {
        let options = SurfaceOptions { mesh: MeshOptions { keep_all: true, ..MeshOptions::default() }, ..SurfaceOptions::default() };
        let surface = |submap: &Submap| {
            let mut mesh = options.extract(submap);
            mesh.transform(&Rigid::from(&submap.t_map_submap()));
            (submap.id(), mesh)
        };
        self.submaps.par_iter().map(surface).collect()
    }
}
