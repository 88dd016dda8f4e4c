//! Pose graphs in the text format of g2o: `VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT`, `FIX`.

mod read;
mod write;

pub use read::{parse, read};
pub use write::write;
