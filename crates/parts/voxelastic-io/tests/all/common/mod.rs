//! What several tests need.

pub mod damage;
pub mod encode;
