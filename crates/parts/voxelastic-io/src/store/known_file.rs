//! A submap file that was written before.

use super::files::SubmapName;
use super::sections::submap_file::Written;
use std::path::{Path, PathBuf};

/// A file that a submap need not be written to again.
#[derive(Clone, Debug)]
pub(super) struct KnownFile {
    pub name: SubmapName,
    pub written: Written,
    pub path: PathBuf,
}

impl KnownFile {
    /// Whether it is a file of the map directory `dir` already.
    pub fn is_in(&self, dir: &Path) -> bool {
        self.path.parent() == Some(dir)
    }
}
