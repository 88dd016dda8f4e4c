//! Errors of this crate.

use std::path::PathBuf;

/// Errors of building, simulating, reading and writing worlds.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// No world has this name.
    #[error("unknown world `{name}`: choose one of {known}")]
    UnknownWorld {
        /// The unknown name.
        name: String,
        /// Names that exist.
        known: String,
    },
    /// No carrier has this name.
    #[error("unknown carrier `{name}`: choose one of {known}")]
    UnknownCarrier {
        /// The unknown name.
        name: String,
        /// Names that exist.
        known: String,
    },
    /// A setting that is NaN or out of range.
    #[error("{setting} is {value}: it must be {allowed}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range, in words.
        allowed: &'static str,
    },
    /// A solid with a size or position that is not finite, or a negative size.
    #[error("solid {index} has a size or a position that is not finite, or a negative size")]
    Solid {
        /// Index in the order of insertion.
        index: usize,
    },
    /// The sensor is unknown or impossible.
    #[error(transparent)]
    Sensor(#[from] voxelastic::sensor::SensorError),
    /// A file or folder could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The folder to write is not empty.
    #[error("{}: the folder is not empty; name another one, or empty it first", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// What is to be a folder is a file.
    #[error("{}: this is a file, not a folder", path.display())]
    NoFolder {
        /// The file.
        path: PathBuf,
    },
    /// The folder to write is none that a simulation wrote.
    #[error("{}: not a simulated folder: {} would be lost", path.display(), lost.display())]
    NotSimulated {
        /// The folder.
        path: PathBuf,
        /// What is in it.
        lost: PathBuf,
    },
    /// An invalid world file.
    #[error("{}: {message}", path.display())]
    WorldFile {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column where there is one.
        message: String,
    },
    /// This version builds the world of a world file differently, so distances to it would be wrong.
    #[error("{}: the world `{name}` has changed since this was written (fingerprint {found}, now {built}): simulate it again, or use the version that wrote it", path.display())]
    WorldChanged {
        /// The file.
        path: PathBuf,
        /// The world's name.
        name: String,
        /// Fingerprint in the file.
        found: String,
        /// Fingerprint of the world as built by this version.
        built: String,
    },
    /// A cloud, trajectory or graph could not be written.
    #[error(transparent)]
    Write(#[from] voxelastic_io::Error),
    /// A picture could not be made.
    #[error("the picture cannot be made: {0}")]
    Picture(String),
}

impl SimError {
    /// Adds the path to an input or output error.
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }
}
