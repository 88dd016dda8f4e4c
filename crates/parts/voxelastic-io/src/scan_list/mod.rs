//! What folders and recordings have in common when they become a registered cloud list (paper Sec. IV): scans with poses, edges between
//! them, keyframing, and the poses of scans after a correction.

mod continuation;
mod edges;
mod keyframing;
mod scan_entry;

pub(crate) use continuation::Continuation;
pub(crate) use edges::ScanEdges;
pub(crate) use keyframing::select;
pub use keyframing::{KeyframeFilter, Keyframing};
pub use scan_entry::ScanEntry;
pub(crate) use scan_entry::{NODES_OF_SENSOR, read_scan, undistorted_sign_of};
