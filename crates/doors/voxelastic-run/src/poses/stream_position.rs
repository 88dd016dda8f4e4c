//! How far a run is in what comes.

use serde::{Deserialize, Serialize};
use voxelastic_io::ReadPosition;

/// How far a run is in what comes, and how much that was.
#[derive(Clone, Debug, Default)]
pub struct StreamPosition {
    /// Whether what comes can be read again from a position.
    is_recorded: bool,
    /// Where the reading was after the last input that was taken.
    position: Option<ReadPosition>,
    came: Came,
    /// The same of earlier processes.
    before: Came,
}

/// Scans that came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Came {
    /// With those that were left out.
    pub scans: usize,
    /// Scans that were left out, because newer ones came before they could be mapped.
    pub left_out: usize,
    /// Inputs of all kinds that were taken.
    pub inputs: u64,
    /// Of which data they were, if that is known: see [`Source::fingerprint`](crate::Source::fingerprint).
    pub data: Option<u64>,
}

impl StreamPosition {
    /// Of a recording, or of scans that come only once.
    pub fn new(is_recorded: bool) -> Self {
        Self { is_recorded, ..Self::default() }
    }

    /// After what an earlier process has taken.
    #[must_use]
    pub fn after(self, before: Came) -> Self {
        Self { before, ..self }
    }

    /// Where the reading of a recording is, if it can go on from there; none within, where nobody can.
    pub fn position(&self) -> Option<Option<ReadPosition>> {
        if self.is_recorded { self.position.clone().map(Some) } else { Some(None) }
    }

    /// An input was taken, after which the reading was here.
    pub fn note(&mut self, position: Option<ReadPosition>) {
        self.position = position;
    }

    /// A scan was taken, and so many were left out until then.
    pub fn note_scan(&mut self, left_out: usize) {
        let taken = self.came.scans - self.came.left_out + 1;
        (self.came.scans, self.came.left_out) = (taken + left_out, left_out);
    }

    /// An input was taken.
    pub(crate) fn note_input(&mut self) {
        self.came.inputs += 1;
    }

    /// Inputs are those of `data` from here on. Returns how many of them an earlier process has taken already; none if it had taken others.
    pub(crate) fn begin_data(&mut self, data: u64) -> Option<u64> {
        if self.came.data.replace(data).is_some() || self.came.inputs > 0 {
            return Some(0);
        }
        match self.before.data {
            Some(before) if before != data => None,
            Some(_) => Some(self.before.inputs),
            None => Some(0),
        }
    }

    /// Scans that came, in all.
    pub fn came(&self) -> Came {
        let Came { scans, left_out, inputs, data } = self.came;
        let before = self.before;
        Came { scans: before.scans + scans, left_out: before.left_out + left_out, inputs: before.inputs + inputs, data: data.or(before.data) }
    }

    /// Scans that came to earlier processes.
    pub fn before(&self) -> Came {
        self.before
    }
}
