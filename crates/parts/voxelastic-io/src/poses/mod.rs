//! Trajectories as text files with a pose on each line, by their headings or columns; LIO-SAM's key poses; and lists of times.

mod detect;
mod layout;
mod lio_sam;
mod read;
mod rows;
mod times;
mod trajectory;
mod write;

pub use detect::PoseFormat;
pub(crate) use detect::{TextContent, detect};
pub use layout::Layout;
pub(crate) use read::KNOWN_FORMATS;
pub use read::{parse, read};
pub use times::{parse_times, read_times};
pub use trajectory::Trajectory;
pub use write::{write_kitti, write_tum};
