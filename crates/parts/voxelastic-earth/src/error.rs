//! The error of this crate.

/// Why coordinates, fixes or an alignment cannot be used, and what helps.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EarthError {
    /// A line of a file.
    #[error("line {line}: {problem}")]
    Line {
        /// From 1.
        line: usize,
        /// What is wrong.
        problem: String,
        /// What helps.
        remedy: &'static str,
    },
    /// All of something.
    #[error("{problem}")]
    Unusable {
        /// What is wrong.
        problem: String,
        /// What helps.
        remedy: &'static str,
    },
}

impl EarthError {
    pub(crate) fn new(problem: impl Into<String>, remedy: &'static str) -> Self {
        Self::Unusable { problem: problem.into(), remedy }
    }

    pub(crate) fn line(line: usize, problem: impl Into<String>, remedy: &'static str) -> Self {
        Self::Line { line, problem: problem.into(), remedy }
    }

    /// What helps.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Line { remedy, .. } | Self::Unusable { remedy, .. } => remedy,
        }
    }
}
