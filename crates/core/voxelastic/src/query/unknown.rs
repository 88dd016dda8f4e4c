//! How queries treat unknown space.

/// How unknown space counts in a query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UnknownAs {
    /// As blocked: robots stay out of it, rays end at it.
    #[default]
    Blocked,
    /// As free, for example to explore it.
    Free,
}
