//! What several tests need.

pub mod drive;
pub mod logit;
pub mod numbers;
