//! Edits and sessions of a map, and damaged maps.

pub mod changes;
pub mod edit;
pub mod merge;
pub mod refine;
pub mod remove;
pub mod repair;
