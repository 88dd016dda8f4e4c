//! Submaps and elasticity (paper Sec. IV): an atlas of rigid submaps whose root poses follow the pose graph.
//!
//! [`graph`] knows nodes and distances along the graph, [`cluster`] which of them share a submap (IV-A), [`fusion`] makes one submap of
//! two (IV-C), [`overlap`] tells what a scan would add to a submap, and [`MeshCache`] keeps surfaces in their submap's frame, so that a
//! pose correction (IV-D) costs a matrix. Who decides when what happens is the [`mapper`](crate::mapper).

pub mod cluster;
pub mod fusion;
pub mod graph;
mod members;
mod mesh_cache;
pub mod overlap;
mod submap;

pub use members::Members;
pub use mesh_cache::MeshCache;
pub use submap::{Submap, SubmapId, SubmapScan};

use crate::field::tsdf::BrickPages;
use crate::geometry::Pose;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The set of all submaps.
#[derive(Clone, Debug, Default)]
pub struct Atlas {
    submaps: Vec<Submap>,
    next_id: SubmapId,
    retiring: Option<Retired>,
}

/// A submap on its way into another one.
#[derive(Clone, Debug)]
struct Retired {
    submap: Arc<Submap>,
    target: SubmapId,
    t_target_submap: Pose,
}

/// A submap that is being fused into another one right now.
#[derive(Clone, Copy, Debug)]
pub struct Retiring<'a> {
    /// The submap; nothing changes it any more. Its own root pose is out of date.
    pub submap: &'a Submap,
    /// Where it lies in the map: it follows the submap that it goes into.
    pub t_map_submap: Pose,
}

impl Atlas {
    /// Puts an atlas together from stored submaps, ordered by id.
    pub fn from_submaps(mut submaps: Vec<Submap>) -> Self {
        submaps.sort_by_key(|s| s.id);
        let next_id = submaps.last().map_or(0, |s| s.id + 1);
        Self { submaps, next_id, retiring: None }
    }

    /// All submaps, ordered by id.
    pub fn submaps(&self) -> &[Submap] {
        &self.submaps
    }

    /// The submap that is being fused into another one right now: until that is done, part of the map is here only. None in a map whose
    /// mapper has [finished](crate::Mapper::finish).
    pub fn retiring(&self) -> Option<Retiring<'_>> {
        let retired = self.retiring.as_ref()?;
        let target = self.submap(retired.target)?;
        Some(Retiring { submap: &retired.submap, t_map_submap: target.t_map_submap * retired.t_target_submap })
    }

    /// Takes submap `id` out of the list to be fused into `target`, in which it lies at `t_target_submap`.
    pub(crate) fn retire(&mut self, id: SubmapId, target: SubmapId, t_target_submap: Pose) -> Option<Arc<Submap>> {
        let place = self.submaps.binary_search_by_key(&id, |s| s.id).ok()?;
        let submap = Arc::new(self.submaps.remove(place));
        self.retiring = Some(Retired { submap: Arc::clone(&submap), target, t_target_submap });
        Some(submap)
    }

    /// Forgets the retiring submap: it has become part of another one.
    pub(crate) fn forget_retiring(&mut self) {
        self.retiring = None;
    }

    /// All submaps, ordered by id.
    pub fn submaps_mut(&mut self) -> &mut [Submap] {
        &mut self.submaps
    }

    /// Lets all submaps but `busy` come to rest, a step further, and gives it the memory that this frees: a scan that enters a submap
    /// would else wait for much that is new.
    pub(crate) fn rest_beside(&mut self, busy: SubmapId) {
        /// Bricks that are laid to rest beside a scan: a submap has left memory ten or twenty scans after it was left itself.
        const MOST_AT_ONCE: usize = 8192;
        let (mut pages, mut left) = (BrickPages::new(), MOST_AT_ONCE);
        for submap in self.submaps.iter_mut().filter(|s| s.id != busy) {
            left -= submap.tsdf.rest_from_the_end(left, &mut pages);
        }
        if let Some(submap) = self.submap_mut(busy) {
            submap.tsdf.adopt(pages);
        }
    }

    /// Lets all submaps come to rest.
    pub(crate) fn rest(&mut self) {
        self.submaps.iter_mut().for_each(|submap| submap.tsdf.rest_all());
    }

    /// The submap with `id`.
    pub fn submap(&self, id: SubmapId) -> Option<&Submap> {
        self.submaps.binary_search_by_key(&id, |s| s.id).ok().map(|i| &self.submaps[i])
    }

    /// The submap with `id`.
    pub fn submap_mut(&mut self, id: SubmapId) -> Option<&mut Submap> {
        self.submaps.binary_search_by_key(&id, |s| s.id).ok().map(|i| &mut self.submaps[i])
    }

    /// The submap with `id`, and beside it `others` with their poses in the map; what is on its way into one of them is among these.
    pub(crate) fn beside(&mut self, id: SubmapId, others: &BTreeSet<SubmapId>) -> Option<(&mut Submap, Vec<(&Submap, Pose)>)> {
        let place = self.submaps.binary_search_by_key(&id, |s| s.id).ok()?;
        let (before, rest) = self.submaps.split_at_mut(place);
        let (submap, after) = rest.split_first_mut()?;
        let pose_of = |target: SubmapId| {
            if target == submap.id {
                Some(submap.t_map_submap)
            } else {
                before.iter().chain(&*after).find(|s| s.id == target).map(|s| s.t_map_submap)
            }
        };
        let retiring = self.retiring.iter().filter(|retired| others.contains(&retired.target));
        let retiring = retiring.filter_map(|retired| Some((&*retired.submap, pose_of(retired.target)? * retired.t_target_submap)));
        let mut beside: Vec<(&Submap, Pose)> = retiring.collect();
        beside.extend(before.iter().chain(&*after).filter(|s| others.contains(&s.id)).map(|s| (s, s.t_map_submap)));
        Some((submap, beside))
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
        self.submaps.iter().chain(self.retiring.iter().map(|r| &*r.submap)).map(|s| s.scans.len()).sum()
    }

    /// Bytes that the submaps' fields hold.
    pub fn bytes(&self) -> usize {
        self.submaps.iter().chain(self.retiring.iter().map(|r| &*r.submap)).map(Submap::bytes).sum()
    }
}
