//! Where the reading of scans is, so that another process can go on from there.

use crate::dataset::FolderPosition;
use serde::{Deserialize, Serialize};

/// A place between two events of a [`Source`](crate::source::Source), or between two scans of [`RawScans`](crate::raw::RawScans).
///
/// Its serialised form belongs to the version of the program that wrote it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReadPosition(pub(crate) Place);

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) enum Place {
    /// In a folder, from which can be read at once.
    Folder(FolderPosition),
    /// In a folder without poses: scans before it, and samples of an inertial unit.
    RawFolder { scans: usize, samples: usize },
    /// After so many items of a recording, which is read from its beginning.
    Recording { items: usize },
}

impl ReadPosition {
    /// Items that have to be read again to get there, because a recording can only be read from its beginning.
    pub fn items_to_skip(&self) -> usize {
        if let Place::Recording { items } = self.0 { items } else { 0 }
    }
}
