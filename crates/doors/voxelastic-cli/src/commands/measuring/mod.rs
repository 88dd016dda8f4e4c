//! What a map is measured with.

pub mod demo;
pub mod eval;
pub mod heldout;
pub mod simulate;
