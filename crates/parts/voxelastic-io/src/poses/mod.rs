//! Trajectories as text files: TUM, KITTI rows, Newer College CSV; LIO-SAM's key poses; and lists of times.

mod detect;
mod kitti;
mod lio_sam;
mod newer_college;
mod read;
mod times;
mod trajectory;
mod tum;
mod write;

pub use detect::PoseFormat;
pub(crate) use detect::{TextContent, detect};
pub use read::{parse, read};
pub use times::{parse_times, read_times};
pub use trajectory::Trajectory;
pub use write::{write_kitti, write_tum};
