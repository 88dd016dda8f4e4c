//! Why a run cannot begin, go on or be kept.

use voxelastic::mapper::{MapError, RebuildError};
use voxelastic::settings::SettingError;
use voxelastic_slam::SlamError;

/// Result of a step of a run.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why something of a run did not work, and what helps.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Something went wrong while the run went on.
    #[error("{message}")]
    Failed {
        /// What happened, to what.
        message: String,
        /// What helps; empty if nothing is known.
        remedy: String,
    },
    /// What was asked for has no meaning, or contradicts itself.
    #[error("{message}")]
    Usage {
        /// What is wrong with it.
        message: String,
        /// What to ask for instead.
        remedy: String,
    },
    /// While something was done that the message names.
    #[error("{doing}")]
    During {
        /// What was done.
        doing: String,
        /// What went wrong.
        source: Box<Error>,
    },
    /// A file or folder.
    #[error(transparent)]
    Io(#[from] voxelastic_io::Error),
    /// An event that the mapper refuses.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A submap that cannot be rebuilt.
    #[error(transparent)]
    Rebuild(#[from] RebuildError),
    /// Settings.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A pose graph that cannot be optimised.
    #[error(transparent)]
    Slam(#[from] SlamError),
    /// Colours from images.
    #[error(transparent)]
    Colour(#[from] voxelastic_colour::ColourError),
    /// The log of the run.
    #[error(transparent)]
    Log(#[from] voxelastic_report::ReportError),
    /// What is kept of a run.
    #[error(transparent)]
    State(#[from] postcard::Error),
    /// The system.
    #[error(transparent)]
    System(#[from] std::io::Error),
}

impl Error {
    /// Something that went wrong, and what helps.
    pub fn new(message: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Failed { message: message.into(), remedy: remedy.into() }
    }

    /// Something that was asked for and has no meaning, and what to ask for instead.
    pub fn usage(message: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Usage { message: message.into(), remedy: remedy.into() }
    }

    /// What helps, if that is known.
    pub fn remedy(&self) -> Option<&str> {
        match self {
            Self::Failed { remedy, .. } | Self::Usage { remedy, .. } => Some(remedy.as_str()).filter(|remedy| !remedy.is_empty()),
            Self::During { source, .. } => source.remedy(),
            _ => None,
        }
    }

    /// Whether what was asked for is wrong, and not what happened.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Usage { .. } | Self::Setting(_) => true,
            Self::During { source, .. } => source.is_usage(),
            _ => false,
        }
    }

    /// The error of a file below it, if that is what it is.
    pub fn file(&self) -> Option<&voxelastic_io::Error> {
        match self {
            Self::Io(error) => Some(error),
            Self::During { source, .. } => source.file(),
            _ => None,
        }
    }

    /// Whether another disk, or more space on this one, could help.
    pub fn is_of_the_system(&self) -> bool {
        match self {
            Self::System(_) => true,
            Self::During { source, .. } => source.is_of_the_system(),
            other => chain(other).any(|cause| cause.downcast_ref::<std::io::Error>().is_some()),
        }
    }

    /// The message with its causes on one line, for a log. A cause whose text is part of the message before it is left out.
    pub fn one_line(&self) -> String {
        one_line(self)
    }
}

/// An error with its causes on one line, for a log. A cause whose text is part of the message before it is left out.
pub fn one_line(error: &(dyn std::error::Error + 'static)) -> String {
    messages(error).join(": ")
}

/// The messages of an error and of its causes. A cause whose text is part of the message before it is left out.
pub fn messages(error: &(dyn std::error::Error + 'static)) -> Vec<String> {
    let mut messages: Vec<String> = chain(error).map(ToString::to_string).collect();
    messages.dedup_by(|cause, before| before.contains(cause.as_str()));
    messages
}

fn chain<'a>(error: &'a (dyn std::error::Error + 'static)) -> impl Iterator<Item = &'a (dyn std::error::Error + 'static)> {
    std::iter::successors(Some(error), |error| error.source())
}

/// Says what was done when something went wrong.
pub trait During<T> {
    /// The error, with what was done before it.
    ///
    /// # Errors
    /// That of the result.
    fn during(self, doing: impl Into<String>) -> Result<T>;
}

impl<T, E: Into<Error>> During<T> for std::result::Result<T, E> {
    fn during(self, doing: impl Into<String>) -> Result<T> {
        self.map_err(|error| Error::During { doing: doing.into(), source: Box::new(error.into()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_each_cause_once_and_knows_what_helps() {
        let full: Result<()> = Err(Error::new("the disk is full", "free some space"));
        let error = full.during("cannot save the map").unwrap_err();
        assert_eq!(error.one_line(), "cannot save the map: the disk is full");
        assert_eq!((error.remedy(), error.is_usage(), error.is_of_the_system()), (Some("free some space"), false, false));
        let refused: Result<()> = Err(Error::from(std::io::Error::other("no space"))).during("no space left");
        let refused = refused.unwrap_err();
        assert_eq!(refused.one_line(), "no space left");
        assert!(refused.is_of_the_system() && refused.remedy().is_none());
        assert!(Error::usage("both", "one").is_usage());
    }
}
