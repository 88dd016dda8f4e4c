//! What can go wrong with a map directory.

use std::path::{Path, PathBuf};

/// Errors of the map store. Each names the file, the place in it, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The path is not a map directory.
    #[error("{}: not a Voxelastic map: {reason}", path.display())]
    NotAMap {
        /// The path that was given.
        path: PathBuf,
        /// What is there instead.
        reason: &'static str,
    },
    /// A new map would be written over files that are not a map's.
    #[error("{}: refusing to write a map here: the directory is not empty and holds no map (found {found:?}); choose a new directory", path.display())]
    WouldOverwrite {
        /// The directory.
        path: PathBuf,
        /// The first of the files in it, by name.
        found: String,
    },
    /// Another process is writing this map.
    #[error("{}: process {pid} is writing this map; wait for it to end, or write to another directory", path.display())]
    Locked {
        /// The map directory.
        path: PathBuf,
        /// The other process, as far as it is known.
        pid: String,
    },
    /// The file system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What was tried, as a verb.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
    /// A file that the manifest names is not there.
    #[error("{}: missing, but the manifest names it; restore it from a backup, or open the map again if it was being saved meanwhile", path.display())]
    Missing {
        /// The submap file.
        path: PathBuf,
    },
    /// A file's content is not what was written.
    #[error("{}: damaged in its {section} at byte {offset}: {what}; restore the file from a backup or map the data again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Part of the file: `header`, `section table`, `tsdf section`, `text`, `length`.
        section: String,
        /// Where in the file the damage was noticed; the damage itself may lie later in the same part.
        offset: u64,
        /// What was found there.
        what: String,
    },
    /// The file was written by a newer program.
    #[error("{}: written in format version {found}, but this program reads versions up to {supported}; update voxelastic", path.display())]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The newest version that can be read.
        supported: u32,
    },
    /// A submap holds a field that this program does not know.
    #[error("{}: unknown section {tag:?} at byte {offset}: the submap holds a field that this program does not know; update voxelastic", path.display())]
    UnknownSection {
        /// The submap file.
        path: PathBuf,
        /// The section's tag.
        tag: String,
        /// Where the section lies.
        offset: u64,
    },
    /// The map has no such submap.
    #[error("{}: the map has no submap {id}", path.display())]
    NoSuchSubmap {
        /// The map directory.
        path: PathBuf,
        /// The identifier that was asked for.
        id: u32,
    },
    /// The atlas cannot be stored as it is.
    #[error("submap {id} cannot be saved: {what}")]
    Unstorable {
        /// The submap.
        id: u32,
        /// What is wrong with it.
        what: String,
    },
    /// A file is larger than the memory that is left.
    #[error("{}: {bytes} bytes do not fit into memory; close other programs or use a larger machine", path.display())]
    OutOfMemory {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
}

/// Result of the map store.
pub type Result<T> = std::result::Result<T, StoreError>;

impl StoreError {
    /// Wraps an I/O error: `action` is a verb, as in "cannot read FILE".
    pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), action, source }
    }

    pub(super) fn damaged(path: &Path, section: &str, offset: u64, what: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), section: section.to_owned(), offset, what: what.into() }
    }
}
