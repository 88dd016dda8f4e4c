//! Point clouds in the PCD format of the Point Cloud Library.

mod write;

pub use write::write;
