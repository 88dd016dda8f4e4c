//! What several tests need.

pub mod room;
