//! Errors: each names the file, the position in it, and the remedy.

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

/// Result of everything in this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Where in a file something is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Position {
    /// The file as a whole.
    File,
    /// A line of a text file, 1-based, and the field of that line if one is to blame.
    Line {
        /// Line number, 1-based.
        line: usize,
        /// Name of the field, such as `qx`.
        field: Option<Cow<'static, str>>,
    },
    /// A byte offset from the beginning of the file.
    Byte(u64),
    /// A named field or record, such as a PCD field or a PLY property.
    Field(String),
}

impl Position {
    /// A line without a field.
    pub fn line(line: usize) -> Self {
        Self::Line { line, field: None }
    }
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File => Ok(()),
            Self::Line { line, field: None } => write!(f, ", line {line}"),
            Self::Line { line, field: Some(field) } => write!(f, ", line {line}, field {field}"),
            Self::Byte(offset) => write!(f, ", byte {offset}"),
            Self::Field(name) => write!(f, ", field `{name}`"),
        }
    }
}

/// Errors of this crate. Each names the file or folder, the position in it where that is known, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused: no such file, no permission, disk full.
    #[error("{}: cannot {doing}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried: `read`, `write`, `list`.
        doing: &'static str,
        /// What the system answered.
        source: io::Error,
    },
    /// The file's content breaks the rules of its format.
    #[error("{}{at}: {problem}; {remedy}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Where in the file.
        at: Position,
        /// What is wrong there.
        problem: String,
        /// What to do about it.
        remedy: Cow<'static, str>,
    },
    /// A cloud without a single measured return: only NaN or all-zero points, or no point at all.
    #[error("{}: no return among its {points} points; the sensor saw nothing or the file holds another format: leave the scan out", path.display())]
    NoReturn {
        /// The cloud file.
        path: PathBuf,
        /// How many points it holds.
        points: usize,
    },
    /// Several files could be meant, and choosing for the user would be guessing.
    #[error("{}: several {what}, choose one with {flag}: {}", path.display(), choices.join(", "))]
    Ambiguous {
        /// The folder.
        path: PathBuf,
        /// What there are several of: `pose files`, `pose graphs`.
        what: &'static str,
        /// The setting that chooses.
        flag: &'static str,
        /// What it can be set to.
        choices: Vec<String>,
    },
    /// Data without poses. Their clouds can be read with [`crate::raw`].
    #[error("{}: {problem}; {remedy}", path.display())]
    NoPoses {
        /// The folder or recording.
        path: PathBuf,
        /// What was looked for.
        problem: String,
        /// What to do about it.
        remedy: Cow<'static, str>,
    },
    /// A message of a recording or a robot holds a pose that is none: it is left out, and no scan with it.
    #[error("{}: {problem}; the poses before and after it are used", path.display())]
    BadPose {
        /// The recording.
        path: PathBuf,
        /// The message, and what is wrong with it.
        problem: String,
    },
    /// A folder lacks something, or its parts do not belong together.
    #[error("{}: {problem}; {remedy}", path.display())]
    Dataset {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What to do about it.
        remedy: Cow<'static, str>,
    },
    /// What was given to a writer cannot be written: nothing was.
    #[error("{}: not written: {problem}", path.display())]
    Unwritable {
        /// The file that was to be written.
        path: PathBuf,
        /// What is wrong with the data.
        problem: String,
    },
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
    /// The map has edits, which whoever writes it otherwise would lose.
    #[error("{}: the map has edits, which would be lost; `voxelastic edit` takes them back with `--undo all`, or makes them part of the map with `--keep`", path.display())]
    Edited {
        /// The map directory.
        path: PathBuf,
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
    /// The file was written in another version of the format, by an older or a newer program.
    #[error("{}: written in format version {found}, but this program reads version {supported} only; map the data again, to another directory", path.display())]
    OtherVersion {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The version that can be read.
        supported: u32,
    },
    /// A submap file has a section that this program does not know.
    #[error("{}: unknown section {tag:?} at byte {offset}: the submap has a field that this program does not know; update voxelastic", path.display())]
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
    /// The map has no such session.
    #[error("{}: the map has no session {number}, but {known:?}", path.display())]
    NoSuchSession {
        /// The map directory.
        path: PathBuf,
        /// The number that was asked for.
        number: u32,
        /// Those that it has.
        known: Vec<u32>,
    },
    /// A decoder has a bug. It is the last item of the data: what comes after cannot be read.
    #[error("a decoder has a bug: {what}; what comes after cannot be read: please report it with the file")]
    Panicked {
        /// The message of the panic.
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

impl Error {
    /// The file or folder that the error is about; empty where that is not known.
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. }
            | Self::Content { path, .. }
            | Self::NoReturn { path, .. }
            | Self::Ambiguous { path, .. }
            | Self::NoPoses { path, .. }
            | Self::BadPose { path, .. }
            | Self::Dataset { path, .. }
            | Self::Unwritable { path, .. }
            | Self::NotAMap { path, .. }
            | Self::WouldOverwrite { path, .. }
            | Self::Locked { path, .. }
            | Self::Edited { path }
            | Self::Missing { path }
            | Self::Damaged { path, .. }
            | Self::OtherVersion { path, .. }
            | Self::UnknownSection { path, .. }
            | Self::NoSuchSubmap { path, .. }
            | Self::NoSuchSession { path, .. }
            | Self::OutOfMemory { path, .. } => path,
            Self::Panicked { .. } => Path::new(""),
        }
    }

    /// Where in the file, where that is known.
    pub fn position(&self) -> Position {
        match self {
            Self::Content { at, .. } => at.clone(),
            Self::Damaged { offset, .. } | Self::UnknownSection { offset, .. } => Position::Byte(*offset),
            _ => Position::File,
        }
    }

    /// What the user can do about it.
    pub fn remedy(&self) -> Cow<'_, str> {
        match self {
            Self::Content { remedy, .. } | Self::NoPoses { remedy, .. } | Self::Dataset { remedy, .. } => Cow::Borrowed(remedy),
            Self::NoReturn { .. } => Cow::Borrowed("leave the scan out"),
            Self::BadPose { .. } => Cow::Borrowed("see why the odometry gives poses that are not finite"),
            Self::Ambiguous { flag, .. } => Cow::Owned(format!("choose one with {flag}")),
            Self::Io { .. } => Cow::Borrowed("check the path, the permissions and the free space"),
            Self::NotAMap { .. } => Cow::Borrowed("give the directory of a map"),
            Self::WouldOverwrite { .. } => Cow::Borrowed("choose a new directory"),
            Self::Locked { .. } => Cow::Borrowed("wait for the other process to end, or write to another directory"),
            Self::Edited { .. } => {
                Cow::Borrowed("`voxelastic edit` takes the edits back with `--undo all`, or makes them part of the map with `--keep`")
            }
            Self::Missing { .. } => Cow::Borrowed("restore the file from a backup, or open the map again if it was being saved meanwhile"),
            Self::Damaged { .. } => Cow::Borrowed("restore the file from a backup or map the data again"),
            Self::OtherVersion { .. } => Cow::Borrowed("map the data again, to another directory"),
            Self::UnknownSection { .. } => Cow::Borrowed("update voxelastic"),
            Self::NoSuchSession { .. } => Cow::Borrowed("`voxelastic info` lists them"),
            Self::NoSuchSubmap { .. } => Cow::Borrowed("choose one of the manifest's submaps"),
            Self::Panicked { .. } => Cow::Borrowed("please report it with the file"),
            Self::OutOfMemory { .. } => Cow::Borrowed("close other programs or use a larger machine"),
            Self::Unwritable { .. } => Cow::Borrowed("this is an error of the program that made the data"),
        }
    }

    pub(crate) fn io(path: &Path, doing: &'static str, source: io::Error) -> Self {
        Self::Io { path: path.into(), doing, source }
    }

    /// For `map_err`: wraps an error of the system. `doing` is a verb, as in "cannot read".
    pub(crate) fn on_io(doing: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_owned(), doing, source }
    }

    /// Damage in a file of the map store.
    pub(crate) fn damaged(path: &Path, section: &str, offset: u64, what: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), section: section.to_owned(), offset, what: what.into() }
    }

    pub(crate) fn content(path: &Path, at: Position, problem: impl Into<String>, remedy: impl Into<Cow<'static, str>>) -> Self {
        Self::Content { path: path.into(), at, problem: problem.into(), remedy: remedy.into() }
    }

    pub(crate) fn no_poses(path: &Path, problem: impl Into<String>, remedy: impl Into<Cow<'static, str>>) -> Self {
        Self::NoPoses { path: path.into(), problem: problem.into(), remedy: remedy.into() }
    }

    pub(crate) fn dataset(path: &Path, problem: impl Into<String>, remedy: impl Into<Cow<'static, str>>) -> Self {
        Self::Dataset { path: path.into(), problem: problem.into(), remedy: remedy.into() }
    }

    pub(crate) fn unwritable(path: &Path, problem: impl Into<String>) -> Self {
        Self::Unwritable { path: path.into(), problem: problem.into() }
    }
}
