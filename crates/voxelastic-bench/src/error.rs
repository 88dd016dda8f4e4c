//! What can go wrong while measuring.

use std::path::PathBuf;

/// Why there is no figure.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A program could not be started.
    #[error("`{command}` cannot be started: {source}")]
    Start {
        /// The command line.
        command: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A program failed.
    #[error("`{command}` failed ({status}): {said}")]
    Failed {
        /// The command line.
        command: String,
        /// How it ended.
        status: String,
        /// The end of what it wrote to stderr.
        said: String,
    },
    /// A program answered something else than it promises.
    #[error("`{command}` gave an answer that cannot be used: {what}")]
    Answer {
        /// The command line.
        command: String,
        /// What is wrong with it.
        what: String,
    },
    /// A file or folder cannot be read or written.
    #[error("{path}: {source}")]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The folder is not the usual campus.
    #[error("{path}: not what `voxelastic simulate campus -o {path}` makes")]
    Campus {
        /// The folder.
        path: PathBuf,
    },
    /// Data that is measured with cannot be read.
    #[error(transparent)]
    Data(#[from] voxelastic_io::Error),
    /// A plot cannot be drawn.
    #[error(transparent)]
    Plot(#[from] voxelastic_eval::EvalError),
    /// A simulation in memory cannot be made or mapped.
    #[error("the simulation in memory: {0}")]
    Simulation(String),
}

impl BenchError {
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, BenchError>;
