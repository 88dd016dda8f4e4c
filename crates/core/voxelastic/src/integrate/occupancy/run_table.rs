//! Which run of rays belongs to a block.

use crate::octree::NONE;
use std::sync::atomic::{AtomicU32, Ordering};

/// The run of rays of each selected block, by block. Each run is taken once, so that the table is empty between scans.
#[derive(Debug, Default)]
pub(super) struct RunTable(Vec<AtomicU32>);

impl Clone for RunTable {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl RunTable {
    /// Makes room for blocks below `blocks`.
    pub fn reserve(&mut self, blocks: u32) {
        let blocks = (blocks as usize).max(self.0.len());
        self.0.resize_with(blocks, || AtomicU32::new(NONE));
    }

    /// The run of a block, or [`NONE`].
    #[inline(always)]
    pub fn get(&self, block: u32) -> u32 {
        self.0.get(block as usize).map_or(NONE, |run| run.load(Ordering::Relaxed))
    }

    /// Sets the run of a block; [`NONE`] removes it.
    #[inline(always)]
    pub fn set(&self, block: u32, run: u32) {
        if let Some(entry) = self.0.get(block as usize) {
            entry.store(run, Ordering::Relaxed);
        }
    }

    /// As [`get`](Self::get), and removes the run.
    #[inline(always)]
    pub fn take(&self, block: u32) -> u32 {
        let run = self.get(block);
        if run != NONE {
            self.set(block, NONE);
        }
        run
    }

    /// Address of the entry of a block, to be prefetched.
    #[inline(always)]
    pub fn address(&self, block: u32) -> *const AtomicU32 {
        &raw const self.0[block as usize]
    }
}
