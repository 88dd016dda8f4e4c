//! What changed in a field lately, for whoever keeps something that is derived from it.

use crate::geometry::Aabb;
use std::collections::VecDeque;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// Flips that are kept, beside those of the latest change.
const KEPT: usize = 1 << 16;

/// Which states of voxels in an octant changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FlipKind {
    /// A voxel became occupied, or no longer is.
    pub occupied: bool,
    /// A voxel became free, or no longer is.
    pub free: bool,
}

impl FlipKind {
    /// The flips of a voxel whose value changes.
    #[inline(always)]
    pub(crate) fn of(before: i8, after: i8) -> Self {
        let is_free = |value: i8| value < 0 && value != super::UNKNOWN;
        Self { occupied: (before > 0) != (after > 0), free: is_free(before) != is_free(after) }
    }

    /// Whether any state changed.
    #[inline(always)]
    pub fn any(self) -> bool {
        self.occupied | self.free
    }
}

/// An octant in which voxels changed their state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flip {
    /// Morton key of its first block.
    pub key: u64,
    /// Its level; 0 for a block.
    pub level: u8,
    /// What changed.
    pub kind: FlipKind,
}

/// The latest changes of a field.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChangeLog {
    /// Number of the latest change, unique in the process: a field that replaces another one is told apart from it.
    revision: u64,
    /// Revision before each change, and the change.
    changes: VecDeque<(u64, Vec<Flip>)>,
    /// Box around everything observed, submap frame, if somebody has asked for it since the latest change.
    pub bounds: OnceLock<Aabb>,
}

/// The last revision of any field.
static LAST: AtomicU64 = AtomicU64::new(0);

impl ChangeLog {
    /// Adds a change.
    pub fn push(&mut self, flips: Vec<Flip>) {
        self.changes.push_back((self.revision, flips));
        self.advance();
        while self.changes.len() > 1 && self.changes.iter().skip(1).map(|(_, flips)| flips.len()).sum::<usize>() > KEPT {
            self.changes.pop_front();
        }
    }

    /// Notes a change of unknown extent.
    pub fn push_unknown(&mut self) {
        self.changes.clear();
        self.advance();
    }

    fn advance(&mut self) {
        self.revision = next_revision();
        self.bounds = OnceLock::new();
    }

    /// Drops what is kept: whoever has not asked for it yet must look at the whole field.
    pub fn forget(&mut self) {
        self.changes = VecDeque::new();
    }

    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// The changes after `revision`; none if they are not kept.
    pub fn since(&self, revision: u64) -> Option<impl Iterator<Item = &Flip>> {
        let first = if revision == self.revision { self.changes.len() } else { self.changes.iter().position(|(before, _)| *before == revision)? };
        Some(self.changes.iter().skip(first).flat_map(|(_, flips)| flips))
    }

    pub fn bytes(&self) -> usize {
        self.changes.iter().map(|(_, flips)| flips.capacity() * size_of::<Flip>()).sum()
    }
}

fn next_revision() -> u64 {
    LAST.fetch_add(1, Ordering::Relaxed) + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_told_from_any_revision_that_is_kept() {
        let flip = |key| Flip { key, level: 0, kind: FlipKind::of(0, 1) };
        let mut log = ChangeLog::default();
        let mut revisions = vec![log.revision()];
        for key in 0..5 {
            log.push(vec![flip(key)]);
            revisions.push(log.revision());
        }
        for (first, &revision) in revisions.iter().enumerate() {
            let keys: Vec<u64> = log.since(revision).unwrap().map(|flip| flip.key).collect();
            assert_eq!(keys, (first as u64..5).collect::<Vec<_>>());
        }
        assert!(log.since(u64::MAX).is_none());
        let other = {
            let mut other = ChangeLog::default();
            other.push(vec![flip(9)]);
            other.revision()
        };
        assert!(log.since(other).is_none(), "of another field");
        log.push((0..KEPT as u64).map(flip).collect());
        log.push(vec![flip(7)]);
        assert!(log.since(revisions[3]).is_none(), "too much to keep");
        assert_eq!(log.since(log.revision()).unwrap().count(), 0);
        let last = log.revision();
        log.forget();
        assert_eq!(log.since(last).unwrap().count(), 0);
        log.push_unknown();
        assert!(log.since(last).is_none());
    }
}
