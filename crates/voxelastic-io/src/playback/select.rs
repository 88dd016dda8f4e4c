//! Which scans of a recording are taken, and what is remembered of those that were.

use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::Motion;
use voxelastic::event::NodeId;

/// A condition on a scan.
#[derive(Clone)]
enum Condition {
    Keep(Arc<dyn Fn(usize) -> bool + Send + Sync>),
    /// Only so many.
    First(usize),
}

/// Conditions on a scan's place among those that met the conditions before.
#[derive(Clone, Default)]
pub(crate) struct Selection {
    conditions: Vec<Condition>,
}

impl fmt::Debug for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Selection({})", self.conditions.len())
    }
}

impl Selection {
    pub(crate) fn add(&mut self, keep: impl Fn(usize) -> bool + Send + Sync + 'static) {
        self.conditions.push(Condition::Keep(Arc::new(keep)));
    }

    /// Takes no more than the first `most`.
    pub(crate) fn limit(&mut self, most: usize) {
        self.conditions.push(Condition::First(most));
    }

    /// Whether nothing that comes will be taken.
    pub(crate) fn is_done(&self, counts: &[usize]) -> bool {
        let full = |(condition, count): (&Condition, &usize)| matches!(condition, Condition::First(most) if count >= most);
        self.conditions.iter().zip(counts).any(full)
    }

    /// Takes or leaves one scan after the other; the counts are those of the scans that met each condition so far.
    pub(crate) fn takes(&self, counts: &mut Vec<usize>) -> bool {
        counts.resize(self.conditions.len(), 0);
        self.conditions.iter().zip(counts).all(|(condition, count)| {
            let place = *count;
            *count += 1;
            match condition {
                Condition::Keep(keep) => keep(place),
                Condition::First(most) => place < *most,
            }
        })
    }
}

/// What is needed to have a scan's cloud again.
#[derive(Clone, Debug)]
pub(crate) struct Taken {
    /// Place among all clouds of the recording.
    pub(crate) index: u64,
    pub(crate) motion: Option<Motion>,
}

/// What becomes known while a recording is played.
#[derive(Debug, Default)]
pub(crate) struct Ledger {
    /// Each scan that was taken, by its node.
    taken: Mutex<HashMap<NodeId, Taken>>,
    /// Scans that a condition left out.
    pub(crate) left_out: AtomicUsize,
    /// Clouds for which there was no pose.
    pub(crate) without_pose: AtomicUsize,
    /// Bits of the time of recording that has been reached, seconds.
    now: AtomicU64,
}

impl Ledger {
    pub(crate) fn note(&self, node: NodeId, taken: Taken) {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner).insert(node, taken);
    }

    pub(crate) fn taken(&self, node: NodeId) -> Option<Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner).get(&node).cloned()
    }

    pub(crate) fn reach(&self, now: f64) {
        self.now.store(now.to_bits(), Ordering::Relaxed);
    }

    /// Time of recording that has been reached, seconds; 0 at the beginning.
    pub(crate) fn now(&self) -> f64 {
        f64::from_bits(self.now.load(Ordering::Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_conditions_count_what_earlier_ones_left() {
        let mut selection = Selection::default();
        selection.limit(6);
        selection.add(|k| k % 3 != 2);
        let mut counts = Vec::new();
        let taken: Vec<usize> = (0..10).filter(|_| selection.takes(&mut counts)).collect();
        assert_eq!(taken, [0, 1, 3, 4]);
        assert!(selection.is_done(&counts) && !selection.is_done(&[5, 5]));
    }
}
