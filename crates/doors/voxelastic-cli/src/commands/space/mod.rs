//! What is free, and ways through it.

pub mod esdf;
pub mod explore;
pub mod plan;
pub mod slice;
