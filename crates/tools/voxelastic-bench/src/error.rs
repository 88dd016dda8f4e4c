//! Errors of this crate.

use std::path::PathBuf;

/// Errors of the benchmarks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A program could not be started.
    #[error("`{command}` cannot be started: {source}")]
    Start {
        /// The command line.
        command: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// A program failed.
    #[error("`{command}` failed ({status}): {message}")]
    Failed {
        /// The command line.
        command: String,
        /// Its exit status.
        status: String,
        /// The last lines of its stderr.
        message: String,
    },
    /// The output of a program is invalid.
    #[error("`{command}` printed an invalid answer: {problem}")]
    Answer {
        /// The command line.
        command: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A file or folder cannot be read or written.
    #[error("{path}: {source}")]
    File {
        /// The file or folder.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The folder is not the default simulated campus.
    #[error("{path}: not what `voxelastic simulate campus -o {path}` makes")]
    Campus {
        /// The folder.
        path: PathBuf,
    },
    /// Input data cannot be read.
    #[error(transparent)]
    Data(#[from] voxelastic_io::Error),
    /// A plot cannot be drawn.
    #[error(transparent)]
    Plot(#[from] voxelastic_eval::EvalError),
    /// A simulation in memory cannot be created or mapped.
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
