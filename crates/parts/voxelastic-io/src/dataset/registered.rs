//! A dataset whose clouds and poses are matched.

use super::description::Description;
use super::events::{Events, FolderPosition};
use super::ground_truth::GroundTruth;
use super::pose_file::Snapshot;
use super::snapshot::SnapshotContext;
use crate::Result;
use crate::fingerprint::Fingerprint;
use crate::scan_list::{ScanEdges, ScanEntry};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::Cloud;
use voxelastic::event::Edge;

/// A dataset whose clouds and poses are matched. No cloud has been decoded.
#[derive(Clone, Debug)]
pub struct Dataset {
    pub(super) path: PathBuf,
    pub(super) scans: Arc<[ScanEntry]>,
    pub(super) edges: Arc<ScanEdges>,
    pub(super) snapshots: Arc<[Snapshot]>,
    pub(super) context: Arc<SnapshotContext>,
    pub(super) ground_truth: Option<GroundTruth>,
    pub(super) description: Description,
}

impl Dataset {
    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The scans that have a pose, in the order of time.
    pub fn scans(&self) -> &[ScanEntry] {
        &self.scans
    }

    /// What was found in the folder, and what is ignored; to be shown to the user.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// The ground truth, if a file of the folder is named so. It is not used unless it is chosen as the poses.
    pub fn ground_truth(&self) -> Option<&GroundTruth> {
        self.ground_truth.as_ref()
    }

    /// Loop edges between scans of the dataset, in lidar frames, in the order of the graph's file.
    pub fn loop_edges(&self) -> &[Edge] {
        &self.edges.loops
    }

    /// Whether the times of the scans are those of a clock, and not their numbers.
    pub fn has_times(&self) -> bool {
        self.context.has_times
    }

    /// The usual time between all clouds of the folder, seconds, if a sweep can take that long.
    pub fn interval_s(&self) -> Option<f64> {
        self.context.sweeps.interval_s
    }

    /// Reads the cloud of one of the scans, as [`events`](Self::events) would deliver it.
    ///
    /// # Errors
    /// As [`crate::clouds::read`].
    pub fn cloud(&self, scan: &ScanEntry) -> Result<Cloud> {
        Ok(self.context.with_motion(scan.read()?.relative_to(scan.time, self.context.sweeps), scan))
    }

    /// Keeps only some of the scans, for instance to hold others out. Loop edges of dropped scans are dropped, too.
    pub fn retain(&mut self, mut keep: impl FnMut(&ScanEntry) -> bool) {
        let kept: Vec<bool> = self.scans.iter().map(&mut keep).collect();
        let mut flags = kept.iter();
        if let Some(truth) = &mut self.ground_truth {
            truth.t_map_lidar.retain(|_| flags.next().copied().unwrap_or(false));
        }
        self.scans = self.scans.iter().zip(&kept).filter(|(_, k)| **k).map(|(s, _)| s.clone()).collect();
        let edges = Arc::make_mut(&mut self.edges);
        self.description.loop_edges_without_scan += edges.retain(&self.scans);
    }

    /// Keeps the first `most` scans and what was known by then: snapshots after a later scan are dropped.
    pub fn truncate(&mut self, most: usize) {
        let Some(first_dropped) = self.scans.get(most).map(|scan| scan.node) else { return };
        let mut index = 0..;
        self.retain(|_| index.next().is_some_and(|index| index < most));
        self.snapshots = self.snapshots.iter().filter(|s| s.after < first_dropped).cloned().collect();
    }

    /// As [`Source::fingerprint`](crate::source::Source::fingerprint).
    pub(crate) fn fingerprint(&self) -> u64 {
        let mut print = Fingerprint::default();
        for scan in self.scans.iter() {
            print.file(&scan.path);
            print.numbers([scan.index as u64, scan.node, scan.time.to_bits()]);
            print.pose(&scan.t_map_lidar);
        }
        for edge in &self.edges.loops {
            print.numbers([edge.from, edge.to]);
            print.pose(&edge.t_from_to);
        }
        self.snapshots.iter().for_each(|snapshot| print.file(&snapshot.file.path));
        print.digest()
    }

    /// The registered cloud list: each scan, an odometry edge from the scan before it (measured if the graph has it, else the relative pose),
    /// loop edges once both scans have been delivered, pose updates from snapshots at their scan. Scans after a snapshot continue from the
    /// corrected poses, unless the pose file already contains the corrections.
    ///
    /// Clouds are decoded on a thread of their own, at most two ahead, so memory does not grow with the dataset. A cloud that
    /// cannot be read is an `Err` item, and the iteration continues with the next.
    pub fn events(&self) -> Events {
        let snapshots = self.snapshots.len();
        self.events_from(FolderPosition { snapshots, ..FolderPosition::default() })
    }

    /// The events from a position on. Clouds before it are not decoded.
    pub(crate) fn events_from(&self, position: FolderPosition) -> Events {
        let snapshots = self.snapshots.iter().cloned().collect();
        Events::new(Arc::clone(&self.scans), Arc::clone(&self.edges), Arc::clone(&self.context), snapshots, position)
    }
}
