//! What several tests need.

pub mod drive;
pub mod numbers;
