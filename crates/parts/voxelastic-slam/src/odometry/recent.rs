//! The last scans, and where they observed space to be free.

use crate::free_space::{FreeSpace, View};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use voxelastic::geometry::{Pose, PoseExt, Rigid};

/// Scans that are kept.
const MOST: usize = 10;
/// Distance between them, in voxels.
const SPACING: f64 = 3.0;

/// The last scans.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct RecentScans {
    scans: VecDeque<RecentScan>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct RecentScan {
    #[serde(with = "voxelastic::geometry::stored")]
    t_map_lidar: Pose,
    /// Lidar frame.
    points: Vec<[f32; 3]>,
}

/// A recent scan in the frame of the last one.
struct Moved {
    origin: [f32; 3],
    points: Vec<[f32; 3]>,
}

impl RecentScans {
    /// Adds a scan, if it was not taken where the last one was.
    pub(super) fn add(&mut self, t_map_lidar: &Pose, points: &[[f32; 3]], voxel: f64) {
        if self.scans.back().is_some_and(|last| last.t_map_lidar.translation_distance(t_map_lidar) < SPACING * voxel) {
            return;
        }
        if self.scans.len() == MOST {
            self.scans.pop_front();
        }
        self.scans.push_back(RecentScan { t_map_lidar: *t_map_lidar, points: points.to_vec() });
    }

    pub(super) fn clear(&mut self) {
        self.scans.clear();
    }

    /// What these scans and a new one say about each other; `None` without any scan.
    pub(super) fn compared<'a>(&self, points: &'a [[f32; 3]], voxel: f64) -> Option<ComparedFreeSpace<'a>> {
        let anchor = self.scans.back()?.t_map_lidar;
        let in_anchor = |scan: &RecentScan| {
            let t_anchor_lidar = anchor.inv_mul(&scan.t_map_lidar);
            let moved = Rigid::from(&t_anchor_lidar);
            let origin = t_anchor_lidar.translation.vector.map(|v| v as f32).into();
            Moved { origin, points: scan.points.iter().map(|p| moved.apply(*p)).collect() }
        };
        let recent: Vec<Moved> = self.scans.iter().map(in_anchor).collect();
        let scan = View { origin: [0.0; 3], points };
        let free_of_recent = FreeSpace::new(&views(&recent), voxel as f32);
        Some(ComparedFreeSpace { anchor, recent, scan, free_of_recent, free_of_scan: FreeSpace::new(&[scan], voxel as f32) })
    }
}

fn views(scans: &[Moved]) -> Vec<View<'_>> {
    scans.iter().map(|scan| View { origin: scan.origin, points: &scan.points }).collect()
}

/// The free space of the last scans and of a new one.
pub(super) struct ComparedFreeSpace<'a> {
    /// Pose of the frame of the last scans in the map.
    anchor: Pose,
    recent: Vec<Moved>,
    scan: View<'a>,
    free_of_recent: FreeSpace,
    free_of_scan: FreeSpace,
}

impl ComparedFreeSpace<'_> {
    /// Share of the surfaces of the last scans or of the new one that lie in space that the other saw to be free, if the new one has this pose:
    /// the larger one; `None` if too little of the one is where the other saw anything.
    pub(super) fn contradiction(&self, t_map_lidar: &Pose) -> Option<f64> {
        let t = self.anchor.inv_mul(t_map_lidar);
        let of_scan = self.free_of_recent.contradiction(&[self.scan], &t)?;
        Some(of_scan.max(self.free_of_scan.contradiction(&views(&self.recent), &t.inverse())?))
    }
}
