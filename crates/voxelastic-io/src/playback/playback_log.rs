//! What a playback reports back: progress, counts, and how to read delivered scans again.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use voxelastic::Motion;
use voxelastic::event::NodeId;

/// What is needed to read a scan's cloud again.
#[derive(Clone, Debug)]
pub(crate) struct DeliveredScan {
    /// Index among all clouds of the recording.
    pub(crate) index: u64,
    pub(crate) motion: Option<Motion>,
}

/// State of a playback, shared with the recording that it came from.
#[derive(Debug, Default)]
pub(crate) struct PlaybackLog {
    /// Delivered scans by node.
    delivered: Mutex<HashMap<NodeId, DeliveredScan>>,
    /// Scans that a condition of the selection excluded.
    pub(crate) left_out: AtomicUsize,
    /// Clouds without a pose.
    pub(crate) without_pose: AtomicUsize,
    /// Bits of the recording time reached, seconds.
    now: AtomicU64,
}

impl PlaybackLog {
    pub(crate) fn add(&self, node: NodeId, scan: DeliveredScan) {
        self.delivered.lock().unwrap_or_else(PoisonError::into_inner).insert(node, scan);
    }

    pub(crate) fn delivered(&self, node: NodeId) -> Option<DeliveredScan> {
        self.delivered.lock().unwrap_or_else(PoisonError::into_inner).get(&node).cloned()
    }

    pub(crate) fn set_now(&self, now: f64) {
        self.now.store(now.to_bits(), Ordering::Relaxed);
    }

    /// Recording time reached, seconds; 0 at the beginning.
    pub(crate) fn now(&self) -> f64 {
        f64::from_bits(self.now.load(Ordering::Relaxed))
    }
}
