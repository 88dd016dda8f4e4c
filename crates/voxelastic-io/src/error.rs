//! What can go wrong with files: every error names the file, the place in it, and the remedy.

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

/// Errors of the input and output crate.
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
}

impl Error {
    /// The file or folder that the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. }
            | Self::Content { path, .. }
            | Self::NoReturn { path, .. }
            | Self::Ambiguous { path, .. }
            | Self::Dataset { path, .. }
            | Self::Unwritable { path, .. } => path,
        }
    }

    /// Where in the file, where that is known.
    pub fn position(&self) -> Position {
        match self {
            Self::Content { at, .. } => at.clone(),
            _ => Position::File,
        }
    }

    /// What the user can do about it.
    pub fn remedy(&self) -> Cow<'_, str> {
        match self {
            Self::Content { remedy, .. } | Self::Dataset { remedy, .. } => Cow::Borrowed(remedy),
            Self::NoReturn { .. } => Cow::Borrowed("leave the scan out"),
            Self::Ambiguous { flag, .. } => Cow::Owned(format!("choose one with {flag}")),
            Self::Io { .. } => Cow::Borrowed("check the path, the permissions and the free space"),
            Self::Unwritable { .. } => Cow::Borrowed("this is an error of the program that made the data"),
        }
    }

    pub(crate) fn io(path: &Path, doing: &'static str, source: io::Error) -> Self {
        Self::Io { path: path.into(), doing, source }
    }

    pub(crate) fn content(path: &Path, at: Position, problem: impl Into<String>, remedy: impl Into<Cow<'static, str>>) -> Self {
        Self::Content { path: path.into(), at, problem: problem.into(), remedy: remedy.into() }
    }

    pub(crate) fn dataset(path: &Path, problem: impl Into<String>, remedy: impl Into<Cow<'static, str>>) -> Self {
        Self::Dataset { path: path.into(), problem: problem.into(), remedy: remedy.into() }
    }

    pub(crate) fn unwritable(path: &Path, problem: impl Into<String>) -> Self {
        Self::Unwritable { path: path.into(), problem: problem.into() }
    }
}
