//! Where the reading of an input was after each of the items that wait to be taken.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic_io::ReadPosition;

/// Positions after each item that was read, shared by the thread that reads and the one that takes.
#[derive(Clone, Debug, Default)]
pub struct Positions(Arc<Mutex<Waiting>>);

#[derive(Debug, Default)]
struct Waiting {
    /// Items whose position is not kept any more.
    before: u64,
    positions: VecDeque<Option<ReadPosition>>,
}

impl Positions {
    /// After the next item; none where the reading cannot go on from there.
    pub fn add(&self, position: Option<ReadPosition>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).positions.push_back(position);
    }

    /// After the first `number` items, if the reading can go on from there. To be asked with growing numbers.
    pub fn after(&self, number: u64) -> Option<ReadPosition> {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found = None;
        while waiting.before < number {
            found = waiting.positions.pop_front()?;
            waiting.before += 1;
        }
        found
    }
}
