//! The atlas: all submaps of a map, ordered by id, and the one that is being fused into another.

use super::{Submap, SubmapId};
use crate::event::NodeId;
use crate::field::tsdf::{BrickPages, TsdfField};
use crate::geometry::Pose;
use std::collections::BTreeSet;
use std::sync::Arc;

/// All submaps of a map. Every submap has the atlas' voxel size.
///
/// ```
/// use voxelastic::Pose;
/// use voxelastic::atlas::Atlas;
/// let mut atlas = Atlas::new(0.065);
/// let id = atlas.spawn(Pose::identity());
/// assert_eq!(atlas.submap(id).map(|submap| submap.voxel_size()), Some(0.065));
/// ```
#[derive(Clone, Debug)]
pub struct Atlas {
    /// Edge of the finest voxel, metres.
    voxel_size: f32,
    submaps: Vec<Submap>,
    next_id: SubmapId,
    fusion_source: Option<FusionSource>,
}

/// A submap whose fusion has begun: it has left the list, and its fields are not all part of the target yet.
#[derive(Clone, Debug)]
struct FusionSource {
    submap: Arc<Submap>,
    target: SubmapId,
    t_target_submap: Pose,
}

/// The source of a fusion that has begun and is not complete.
#[derive(Clone, Copy, Debug)]
pub struct MergingSubmap<'a> {
    /// The source; it does not change any more, and its own root pose is out of date.
    pub submap: &'a Submap,
    /// Its current pose in the map frame: it moves with the target.
    pub t_map_submap: Pose,
}

impl Atlas {
    /// An empty atlas whose finest voxels have edges of `voxel_size` metres.
    pub fn new(voxel_size: f32) -> Self {
        Self { voxel_size, submaps: Vec::new(), next_id: 0, fusion_source: None }
    }

    /// An atlas of given submaps, for example stored ones, in any order; `voxel_size` in metres becomes the voxel size of each.
    pub fn from_submaps(voxel_size: f32, mut submaps: Vec<Submap>) -> Self {
        submaps.sort_by_key(|s| s.id);
        submaps.iter_mut().for_each(|s| s.voxel_size = voxel_size);
        let next_id = submaps.last().map_or(0, |s| s.id + 1);
        Self { voxel_size, submaps, next_id, fusion_source: None }
    }

    /// The id of the next submap.
    pub(crate) fn next_id(&self) -> SubmapId {
        self.next_id
    }

    /// Makes sure that no id below `next` is given to a submap: ids of submaps that were fused into others are not used again.
    pub(crate) fn skip_ids(&mut self, next: SubmapId) {
        self.next_id = self.next_id.max(next);
    }

    /// Edge of the finest voxel of every submap, metres.
    pub fn voxel_size(&self) -> f32 {
        self.voxel_size
    }

    /// All submaps, ordered by id.
    pub fn submaps(&self) -> &[Submap] {
        &self.submaps
    }

    /// The source of a fusion in progress: until the fusion is complete, part of the map exists only there. None in a map whose mapper
    /// has [finished](crate::Mapper::finish).
    pub fn merging(&self) -> Option<MergingSubmap<'_>> {
        let source = self.fusion_source.as_ref()?;
        let target = self.submap(source.target)?;
        Some(MergingSubmap { submap: &source.submap, t_map_submap: target.t_map_submap * source.t_target_submap })
    }

    /// Everything that is part of the map, with root poses in the map frame: the submaps by id, then the source of a fusion in progress.
    pub fn placed(&self) -> impl Iterator<Item = (&Submap, Pose)> {
        let merging = self.merging().map(|merging| (merging.submap, merging.t_map_submap));
        self.submaps.iter().map(|submap| (submap, submap.t_map_submap)).chain(merging)
    }

    /// All scans and where the map has their sensors, map frame, in no order of time.
    pub fn scan_poses(&self) -> impl Iterator<Item = (NodeId, Pose)> {
        self.placed().flat_map(|(submap, t_map_submap)| submap.scans.iter().map(move |scan| (scan.node, t_map_submap * scan.t_submap_lidar)))
    }

    /// The scan with the largest number.
    pub fn newest_scan(&self) -> Option<NodeId> {
        self.placed().flat_map(|(submap, _)| submap.scans.iter().map(|scan| scan.node)).max()
    }

    /// Where the map has the sensor of a scan, map frame; none if it does not have the scan.
    pub fn scan_pose(&self, node: NodeId) -> Option<Pose> {
        self.placed().find_map(|(submap, t_map_submap)| {
            // Mostly one of the newest is asked for.
            let scan = submap.scans.iter().rev().find(|scan| scan.node == node)?;
            Some(t_map_submap * scan.t_submap_lidar)
        })
    }

    /// The TSDFs that have blocks, with their poses in the map frame: those of the submaps by id, then that of a fusion in progress. Submaps
    /// whose poses are not finite are left out.
    pub fn tsdfs(&self) -> Vec<(&TsdfField, Pose)> {
        let all = self.placed().map(|(submap, t_map_submap)| (&submap.tsdf, t_map_submap));
        let is_finite = |pose: &Pose| pose.to_matrix().iter().all(|v| v.is_finite());
        all.filter(|(field, pose)| !field.is_empty() && is_finite(pose)).collect()
    }

    /// Removes submap `id` from the list as the source of a fusion into `target`, in which it lies at `t_target_submap`.
    pub(crate) fn begin_fusion(&mut self, id: SubmapId, target: SubmapId, t_target_submap: Pose) -> Option<Arc<Submap>> {
        let index = self.submaps.binary_search_by_key(&id, |s| s.id).ok()?;
        let submap = Arc::new(self.submaps.remove(index));
        self.fusion_source = Some(FusionSource { submap: Arc::clone(&submap), target, t_target_submap });
        Some(submap)
    }

    /// Drops the source of the fusion in progress: it is part of the target now.
    pub(crate) fn end_fusion(&mut self) {
        self.fusion_source = None;
    }

    /// All submaps, ordered by id. Of a map whose mapper has not finished, the source of a fusion in progress is lost.
    pub fn into_submaps(self) -> Vec<Submap> {
        self.submaps
    }

    /// All submaps, mutable, ordered by id.
    pub fn submaps_mut(&mut self) -> &mut [Submap] {
        &mut self.submaps
    }

    /// Compacts some bricks of all submaps but `active`, and gives the pages that this frees to `active`: a scan that enters a submap
    /// would otherwise wait for the system to provide new memory.
    pub(crate) fn compact_others(&mut self, active: SubmapId) {
        /// Bricks compacted per scan: a submap that no scan enters is compact after ten to twenty scans.
        const BRICKS_PER_SCAN: usize = 8192;
        /// At least this share of the bricks is compacted: with fine voxels they are many.
        const SHARE: usize = 8;
        let resident: usize = self.submaps.iter().filter(|s| s.id != active).map(|s| s.tsdf.resident_bricks()).sum();
        let (mut pages, mut left) = (BrickPages::new(), BRICKS_PER_SCAN.max(resident / SHARE));
        for submap in self.submaps.iter_mut().filter(|s| s.id != active) {
            left -= submap.tsdf.compact_from_end(left, &mut pages);
            submap.occupancy.changes.forget();
        }
        if let Some(submap) = self.submap_mut(active) {
            submap.tsdf.adopt_pages(pages);
        }
    }

    /// Compacts all bricks of all submaps.
    pub(crate) fn compact(&mut self) {
        self.submaps.iter_mut().for_each(|submap| submap.tsdf.compact_all());
    }

    /// The submap with `id`.
    pub fn submap(&self, id: SubmapId) -> Option<&Submap> {
        self.submaps.binary_search_by_key(&id, |s| s.id).ok().map(|i| &self.submaps[i])
    }

    /// The submap with `id`, mutable.
    pub fn submap_mut(&mut self, id: SubmapId) -> Option<&mut Submap> {
        self.submaps.binary_search_by_key(&id, |s| s.id).ok().map(|i| &mut self.submaps[i])
    }

    /// The submap with `id`, mutable, and the submaps `others` with their poses in the map frame; the source of a fusion in progress
    /// into one of `others` is among them.
    pub(crate) fn with_neighbours(&mut self, id: SubmapId, others: &BTreeSet<SubmapId>) -> Option<(&mut Submap, Vec<(&Submap, Pose)>)> {
        let index = self.submaps.binary_search_by_key(&id, |s| s.id).ok()?;
        let (before, rest) = self.submaps.split_at_mut(index);
        let (submap, after) = rest.split_first_mut()?;
        let pose_of = |target: SubmapId| {
            if target == submap.id {
                Some(submap.t_map_submap)
            } else {
                before.iter().chain(&*after).find(|s| s.id == target).map(|s| s.t_map_submap)
            }
        };
        let source = self.fusion_source.iter().filter(|source| others.contains(&source.target));
        let source = source.filter_map(|source| Some((&*source.submap, pose_of(source.target)? * source.t_target_submap)));
        let mut neighbours: Vec<(&Submap, Pose)> = source.collect();
        neighbours.extend(before.iter().chain(&*after).filter(|s| others.contains(&s.id)).map(|s| (s, s.t_map_submap)));
        Some((submap, neighbours))
    }

    /// Adds an empty submap at `t_map_submap` and returns its id.
    pub fn spawn(&mut self, t_map_submap: Pose) -> SubmapId {
        let id = self.next_id;
        self.next_id += 1;
        self.submaps.push(Submap::new(id, self.voxel_size, t_map_submap));
        id
    }

    /// Number of scans integrated into all submaps.
    pub fn scan_count(&self) -> usize {
        self.submaps.iter().chain(self.fusion_source.iter().map(|source| &*source.submap)).map(|s| s.scans.len()).sum()
    }

    /// Memory of all submaps' fields, bytes.
    pub fn bytes(&self) -> usize {
        self.submaps.iter().chain(self.fusion_source.iter().map(|source| &*source.submap)).map(Submap::bytes).sum()
    }
}
