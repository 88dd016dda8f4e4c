//! Submaps and elasticity (paper Sec. IV): an atlas of rigid submaps whose root poses follow the pose graph.

mod submap;

pub use submap::{Submap, SubmapId, SubmapScan};

use crate::geometry::Pose;

/// The set of all submaps.
#[derive(Clone, Debug, Default)]
pub struct Atlas {
    submaps: Vec<Submap>,
    next_id: SubmapId,
}

impl Atlas {
    /// Puts an atlas together from stored submaps, ordered by id.
    pub fn from_submaps(mut submaps: Vec<Submap>) -> Self {
        submaps.sort_by_key(|s| s.id);
        let next_id = submaps.last().map_or(0, |s| s.id + 1);
        Self { submaps, next_id }
    }

    /// All submaps, ordered by id.
    pub fn submaps(&self) -> &[Submap] {
        &self.submaps
    }

    /// All submaps, ordered by id.
    pub fn submaps_mut(&mut self) -> &mut [Submap] {
        &mut self.submaps
    }

    /// The submap with `id`.
    pub fn submap(&self, id: SubmapId) -> Option<&Submap> {
        self.submaps.binary_search_by_key(&id, |s| s.id).ok().map(|i| &self.submaps[i])
    }

    /// The submap with `id`.
    pub fn submap_mut(&mut self, id: SubmapId) -> Option<&mut Submap> {
        self.submaps.binary_search_by_key(&id, |s| s.id).ok().map(|i| &mut self.submaps[i])
    }

    /// Starts a new submap at `t_map_submap` and returns its id.
    pub fn spawn(&mut self, t_map_submap: Pose) -> SubmapId {
        let id = self.next_id;
        self.next_id += 1;
        self.submaps.push(Submap::new(id, t_map_submap));
        id
    }

    /// Scans integrated over all submaps.
    pub fn scan_count(&self) -> usize {
        self.submaps.iter().map(|s| s.scans.len()).sum()
    }

    /// Bytes that the submaps' fields hold.
    pub fn bytes(&self) -> usize {
        self.submaps.iter().map(Submap::bytes).sum()
    }
}
