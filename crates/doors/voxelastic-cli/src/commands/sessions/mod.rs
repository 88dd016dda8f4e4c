//! Sessions of a map, and damaged maps.

pub mod changes;
pub mod merge;
pub mod remove;
pub mod repair;
