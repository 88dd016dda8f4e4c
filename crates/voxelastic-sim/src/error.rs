//! What can go wrong when a world is built, driven through and written.

use std::path::PathBuf;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// No world has this name.
    #[error("unknown world `{name}`: choose one of {known}")]
    UnknownWorld {
        /// Name asked for.
        name: String,
        /// Names that exist.
        known: String,
    },
    /// A setting that is not a number, or out of its range.
    #[error("{setting} is {value}: it must be {allowed}")]
    Setting {
        /// Which setting.
        setting: &'static str,
        /// What was given.
        value: f64,
        /// What would do.
        allowed: &'static str,
    },
    /// A solid with a size or place that is not a finite number.
    #[error("solid {index} has a size or a place that is not finite, or a size below zero")]
    Solid {
        /// Place in the list given.
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
        /// What the system says.
        source: std::io::Error,
    },
    /// The folder to write into holds something already.
    #[error("{}: the folder is not empty; name another one, or empty it first", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// A world file that is not understood.
    #[error("{}: {message}", path.display())]
    WorldFile {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column where there is one.
        message: String,
    },
    /// A world file whose world this version builds differently, so that distances to it would be wrong.
    #[error("{}: the world `{name}` has changed since this was written (fingerprint {found}, now {built}): simulate it again, or use the version that wrote it", path.display())]
    WorldChanged {
        /// The file.
        path: PathBuf,
        /// The world's name.
        name: String,
        /// Fingerprint in the file.
        found: String,
        /// Fingerprint of what is built now.
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
    /// Names the file that an input or output error belongs to.
    pub(crate) fn file(path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::File { path, source }
    }
}
