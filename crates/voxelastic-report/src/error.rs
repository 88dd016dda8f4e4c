//! What can go wrong while a page is made.

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// An array of a surface has not one value per vertex, or a triangle names a vertex that does not exist.
    #[error("surface {surface}: {what}")]
    Surface {
        /// Which of the report's surfaces.
        surface: usize,
        /// What does not fit.
        what: String,
    },
    /// The page's data cannot be written as JSON.
    #[error("the page's data cannot be written: {0}")]
    Json(#[from] serde_json::Error),
    /// A run log is of a later version, or is none.
    #[error("the run log cannot be read: {0}; the report goes without it")]
    RunLog(String),
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, ReportError>;
