//! Files with poses, and what their names say about them.

use crate::PoseFormat;
use crate::folders::{name_of, stem_of};
use std::path::PathBuf;

/// A file with poses.
#[derive(Clone, Debug)]
pub(super) struct PoseFile {
    pub(super) path: PathBuf,
    pub(super) format: PoseFormat,
}

impl PoseFile {
    /// The file's name, as shown to the user.
    pub(super) fn name(&self) -> String {
        name_of(&self.path)
    }

    /// Whether its name says that it is the ground truth.
    pub(super) fn is_ground_truth(&self) -> bool {
        let stem = stem_of(&self.path).to_ascii_lowercase();
        let letters: String = stem.chars().filter(char::is_ascii_alphanumeric).collect();
        letters.contains("groundtruth") || stem.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == "gt" || word == "truth")
    }

    /// Whether its name without extension is `stem`, regardless of case.
    pub(super) fn is_named(&self, stem: &str) -> bool {
        stem_of(&self.path).eq_ignore_ascii_case(stem)
    }
}

/// Corrected poses, as known after a scan: `poses@000123.txt`.
#[derive(Clone, Debug)]
pub(super) struct Snapshot {
    /// The node after whose scan they became known.
    pub(super) after: u64,
    pub(super) file: PoseFile,
}
