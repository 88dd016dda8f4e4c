//! What a playback reports back: progress, counts, and how to read delivered scans again.

use crate::scan_list::NODES_OF_SENSOR;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use voxelastic::event::NodeId;
use voxelastic::{Motion, Pose};

/// What is needed to read a scan's cloud again.
#[derive(Clone, Debug)]
pub(crate) struct DeliveredScan {
    /// Index among all clouds of the recording.
    pub(crate) index: u64,
    pub(crate) motion: Option<Motion>,
    /// Where the lidar was, if the cloud has been moved into the frame of the poses: what takes it back.
    pub(crate) moved_by: Option<Pose>,
}

/// The pose that a scan came with, before any correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ReportedPose {
    pub(crate) node: NodeId,
    /// Seconds.
    pub(crate) time: f64,
    /// Of the lidar in the frame of the source of poses.
    pub(crate) t_odom_lidar: Pose,
}

/// State of a playback, shared with the recording that it came from.
#[derive(Debug, Default)]
pub(crate) struct PlaybackLog {
    /// Delivered scans by node; empty where scans come only once.
    delivered: Mutex<HashMap<NodeId, DeliveredScan>>,
    /// Whether scans come only once, so that there is nothing to read again.
    is_passing: bool,
    /// Of the last delivered scan.
    reported: Mutex<Option<ReportedPose>>,
    /// Scans that a condition of the selection excluded.
    pub(crate) left_out: AtomicUsize,
    /// Clouds without a pose.
    pub(crate) without_pose: AtomicUsize,
    /// What scans wait for that come as a robot delivers them.
    waits_for: Mutex<Option<String>>,
    /// What was done about transforms that have changed.
    notes: Mutex<Vec<String>>,
    /// Bits of the recording time reached, seconds.
    now: AtomicU64,
}

impl PlaybackLog {
    /// Of scans that come only once, as those of a robot: what would be needed to read them again is not kept.
    pub(crate) fn of_passing_scans() -> Self {
        Self { is_passing: true, ..Self::default() }
    }

    pub(crate) fn add(&self, node: NodeId, scan: DeliveredScan) {
        if self.is_passing {
            return;
        }
        self.delivered.lock().unwrap_or_else(PoisonError::into_inner).insert(node, scan);
    }

    pub(crate) fn delivered(&self, node: NodeId) -> Option<DeliveredScan> {
        self.delivered.lock().unwrap_or_else(PoisonError::into_inner).get(&node).cloned()
    }

    /// Scans of which that is kept.
    #[cfg(test)]
    pub(crate) fn kept(&self) -> usize {
        self.delivered.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    pub(crate) fn set_reported(&self, pose: ReportedPose) {
        *self.reported.lock().unwrap_or_else(PoisonError::into_inner) = Some(pose);
    }

    /// The pose that the last delivered scan came with.
    pub(crate) fn reported(&self) -> Option<ReportedPose> {
        *self.reported.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The lidar of a sensor was elsewhere on what the poses are of.
    pub(crate) fn remount(&self, sensor: u16, t_old_new: &Pose) {
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(reported) = reported.as_mut().filter(|reported| (reported.node / NODES_OF_SENSOR) == NodeId::from(sensor)) {
            reported.t_odom_lidar *= t_old_new;
        }
    }

    pub(crate) fn set_waits_for(&self, what: Option<String>) {
        *self.waits_for.lock().unwrap_or_else(PoisonError::into_inner) = what;
    }

    pub(crate) fn waits_for(&self) -> Option<String> {
        self.waits_for.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn add_note(&self, note: String) {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).push(note);
    }

    pub(crate) fn take_notes(&self) -> Vec<String> {
        std::mem::take(&mut *self.notes.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn set_now(&self, now: f64) {
        self.now.store(now.to_bits(), Ordering::Relaxed);
    }

    /// Recording time reached, seconds; 0 at the beginning.
    pub(crate) fn now(&self) -> f64 {
        f64::from_bits(self.now.load(Ordering::Relaxed))
    }
}
