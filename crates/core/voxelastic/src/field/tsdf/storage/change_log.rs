//! The blocks that recent scans changed.

use std::collections::VecDeque;

/// The ids of the blocks changed by each of the last scans, oldest scan first.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChangeLog {
    /// The clock value of each scan, and the blocks that it changed.
    pub changes: VecDeque<(u32, Vec<u32>)>,
    /// Number of changes so far; wraps around.
    pub clock: u32,
}

impl ChangeLog {
    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.changes.iter().map(|(_, ids)| 4 * ids.capacity()).sum()
    }
}
