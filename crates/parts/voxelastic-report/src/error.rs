//! Errors of this crate.

/// Errors of making a page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// An array of a surface does not have one value per vertex, or a triangle refers to a vertex that does not exist.
    #[error("surface {surface}: {what}")]
    Surface {
        /// Which of the report's surfaces.
        surface: usize,
        /// What is wrong.
        what: String,
    },
    /// The page's data cannot be written as JSON.
    #[error("the page's data cannot be written: {0}")]
    Json(#[from] serde_json::Error),
    /// A run log is invalid or of a newer format.
    #[error("the run log cannot be read: {0}; the report is made without it")]
    RunLog(String),
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, ReportError>;
