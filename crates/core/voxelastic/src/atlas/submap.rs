//! A submap: its fields, its root pose and the scans integrated into it.

use crate::event::NodeId;
use crate::field::occupancy::OccupancyField;
use crate::field::tsdf::TsdfField;
use crate::geometry::{Pose, PoseExt};

/// Identifier of a submap: unique within an atlas, not reused after a fusion.
pub type SubmapId = u32;

/// A scan that was integrated into a submap.
#[derive(Clone, Debug, PartialEq)]
pub struct SubmapScan {
    /// The pose-graph node of the scan.
    pub node: NodeId,
    /// Pose of the lidar in the submap frame at which it was integrated.
    pub t_submap_lidar: Pose,
}

/// A state of the surfaces of a submap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfaceState {
    revision: u64,
    clock: u32,
}

/// A rigid part of the map (paper Sec. IV): fields in the submap frame S, which the root pose places in the map frame M.
#[derive(Clone, Debug)]
pub struct Submap {
    pub(crate) id: SubmapId,
    pub(crate) voxel_size: f32,
    pub(crate) t_map_submap: Pose,
    pub(crate) scans: Vec<SubmapScan>,
    /// Where the last correction put the lidar of each scan, in the submap frame; fewer than scans where they are as integrated.
    pub(crate) corrected: Vec<Pose>,
    pub(crate) tsdf: TsdfField,
    pub(crate) occupancy: OccupancyField,
    pub(crate) travelled: f64,
    pub(crate) revision: u64,
}

impl Submap {
    /// An empty submap with finest voxels of `voxel_size` metres, its root at `t_map_submap`.
    pub fn new(id: SubmapId, voxel_size: f32, t_map_submap: Pose) -> Self {
        let (tsdf, occupancy) = (TsdfField::default(), OccupancyField::default());
        Self { id, voxel_size, t_map_submap, scans: Vec::new(), corrected: Vec::new(), tsdf, occupancy, travelled: 0.0, revision: 0 }
    }

    /// The same submap with other fields, both in its frame and with its voxel size.
    #[must_use]
    pub fn with_fields(self, tsdf: TsdfField, occupancy: OccupancyField) -> Self {
        Self { tsdf, occupancy, revision: self.revision + 1, ..self }
    }

    /// The same submap with another list of scans, in the order of their integration, and the path length from the root to the last
    /// one in metres.
    #[must_use]
    pub fn with_scans(self, scans: Vec<SubmapScan>, travelled: f64) -> Self {
        Self { scans, corrected: Vec::new(), travelled, ..self }
    }

    /// The same submap with the poses of the lidar, in the submap frame, that the last correction gave its scans, in their order; none for scans that are as integrated.
    #[must_use]
    pub fn with_corrected(self, corrected: Vec<Pose>) -> Self {
        Self { corrected, ..self }
    }

    /// The same submap with another identifier.
    #[must_use]
    pub fn with_id(self, id: SubmapId) -> Self {
        Self { id, ..self }
    }

    /// Its identifier.
    pub fn id(&self) -> SubmapId {
        self.id
    }

    /// Edge of the finest voxel, metres: that of its atlas.
    pub fn voxel_size(&self) -> f32 {
        self.voxel_size
    }

    /// Root pose: the submap frame in the map frame. A pose correction changes this and nothing else.
    pub fn t_map_submap(&self) -> Pose {
        self.t_map_submap
    }

    /// Sets the root pose.
    pub fn set_pose(&mut self, t_map_submap: Pose) {
        self.t_map_submap = t_map_submap;
    }

    /// The scans integrated into it, in that order.
    pub fn scans(&self) -> &[SubmapScan] {
        &self.scans
    }

    /// Poses of the lidar in the submap frame that the last correction gave the scans, in their order; none for scans that are as integrated. The fields stay those of the
    /// scans as they were integrated, but a surface of the whole map is bent by the difference.
    pub fn corrected(&self) -> &[Pose] {
        &self.corrected
    }

    /// The node of each scan with its pose in the submap frame after all corrections.
    pub fn corrected_scans(&self) -> impl Iterator<Item = (NodeId, &Pose)> {
        self.scans.iter().enumerate().map(|(n, scan)| (scan.node, self.corrected.get(n).unwrap_or(&scan.t_submap_lidar)))
    }

    /// The TSDF in the submap frame; empty if the map does not have that field.
    pub fn tsdf(&self) -> &TsdfField {
        &self.tsdf
    }

    /// The TSDF, mutable; counts as a change of the fields.
    pub fn tsdf_mut(&mut self) -> &mut TsdfField {
        self.revision += 1;
        &mut self.tsdf
    }

    /// Free, occupied and unknown space in the submap frame; empty if the map does not have that field.
    pub fn occupancy(&self) -> &OccupancyField {
        &self.occupancy
    }

    /// The occupancy field, mutable; counts as a change of the fields.
    pub fn occupancy_mut(&mut self) -> &mut OccupancyField {
        self.revision += 1;
        &mut self.occupancy
    }

    /// Path length from the root pose to the last scan, metres.
    pub fn travelled(&self) -> f64 {
        self.travelled
    }

    /// Number of changes of the fields: data derived from them (meshes) is up to date if it was made at the same revision. Not stored.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Which state its surfaces are in, to be asked later for what has [changed](Self::surface_changes_since) since.
    pub fn surface_state(&self) -> SurfaceState {
        SurfaceState { revision: self.revision, clock: self.tsdf.change_log.clock }
    }

    /// Morton keys of the blocks of the TSDF that scans changed since; none if it was changed by other means, so that any may have.
    pub fn surface_changes_since(&self, before: SurfaceState) -> Option<impl Iterator<Item = u64>> {
        let now = self.surface_state();
        // Each scan counts in both.
        let is_by_scans = now.revision.wrapping_sub(before.revision) as u32 == now.clock.wrapping_sub(before.clock);
        (is_by_scans || self.tsdf.is_empty()).then(|| self.tsdf.changed_since(before.clock))
    }

    /// Records that the scan of `node`, taken at `t_map_lidar`, is integrated; returns the lidar's pose in the submap frame.
    pub fn add_scan(&mut self, node: NodeId, t_map_lidar: &Pose) -> Pose {
        let t_submap_lidar = self.t_map_submap.inv_mul(t_map_lidar);
        self.add_scan_at(node, t_submap_lidar);
        t_submap_lidar
    }

    /// Records that the scan of `node` is integrated at `t_submap_lidar`.
    pub fn add_scan_at(&mut self, node: NodeId, t_submap_lidar: Pose) {
        self.travelled += self.scans.last().map_or(0.0, |last| last.t_submap_lidar.translation_distance(&t_submap_lidar));
        self.scans.push(SubmapScan { node, t_submap_lidar });
        self.revision += 1;
    }

    /// The node whose pose is the root pose; none before the first scan.
    pub fn root_node(&self) -> Option<NodeId> {
        self.scans.first().map(|s| s.node)
    }

    /// Memory of the fields, bytes.
    pub fn bytes(&self) -> usize {
        self.tsdf.bytes() + self.occupancy.bytes()
    }
}
