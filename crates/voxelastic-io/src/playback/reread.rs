//! Clouds of a recording a second time, to make submaps anew.

use super::{Heard, Ledger, OpenTape, Taken, Tape};
use crate::dataset::in_scan_time;
use std::error::Error;
use std::sync::Arc;
use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;

/// Reads clouds again by their nodes. Nodes asked for in the order of the recording are found in one pass.
pub(crate) struct Reread {
    pub(crate) open: OpenTape,
    pub(crate) ledger: Arc<Ledger>,
    /// The tape, and the place of the cloud that comes next on it.
    pub(crate) tape: Option<(Box<dyn Tape>, u64)>,
}

impl ScanSource for Reread {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        let Taken { index, motion } = self.ledger.taken(node).ok_or("no scan of the recording belongs to it")?;
        let (mut tape, mut next) = match self.tape.take() {
            Some((tape, next)) if next <= index => (tape, next),
            _ => ((self.open)()?, 0),
        };
        // A damaged place was reported when it was read first.
        while let Some(heard) = tape.next() {
            let Ok(Heard::Cloud(cloud)) = heard else { continue };
            next += 1;
            if next > index {
                let decoded = (cloud.decode)()?;
                self.tape = Some((tape, next));
                return Ok(Cloud { motion, ..in_scan_time(decoded, cloud.time) });
            }
        }
        Err("the recording ends before it".into())
    }
}
