//! Sessions that were added to a map, and maps that were joined to one.

pub(super) mod join;
mod moved;
pub(super) mod newest;
pub(super) mod session_writer;
pub(super) mod sessions;
