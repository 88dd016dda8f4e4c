//! The map directory: one manifest and one immutable, checksummed file per submap.
//!
//! ```text
//! hall.vox/
//!   manifest.json                           what the map is made of; replaced last, atomically
//!   submap-000000-5d0ef1b2c3a49687.vxs      the fields of submap 0; the name holds a hash of its content
//!   submap-000001-0a1b2c3d4e5f6071.vxs
//!   edits.toml                              the edits that the map is shown with; absent without any
//!   base.json                               the manifest of before the edits
//!   run.json                                how the run went that made the map; may be absent, and is no part of the map
//!   .lock                                   held by the one process that writes
//!   unfinished/                             a map of what a run has mapped that is under way or was killed, and where it is
//! ```
//!
//! [`MapStore`] reads: opening costs the manifest only, submaps are loaded when asked for. [`MapWriter`] saves: it writes
//! the submaps whose content changed, makes them durable, then replaces the manifest, then removes the files that no
//! manifest names any more. A process that dies at any moment leaves the old map or the new one.
//!
//! A reopened map is the same bit for bit, and so is whatever is integrated into it next. Damage of any kind is a
//! [`Error`](crate::Error) that names the file, the place in it and the remedy.
//!
//! [`Checkpoints`] write the map of a run that is under way, the run's state and a journal of what came, so that another process can go on with it.
//!
//! A map can be made of several sessions ([`SessionEntry`]), which are added to it and taken out again without a change to the others.
//!
//! A map can be edited: [`MapEditor`] keeps the list of edits and the map of before them beside the map that they make of it.
//!
//! [`repair`] makes a map that opens of one that is damaged: from the files that are whole.
//!
//! Submap files (module `submap_file`) are sequences of tagged sections, one per field (modules `tsdf_section` and
//! `occupancy_section`, and `colour_section` for colours of the TSDF; `origin_section` has poses and scans), each a sequence of compressed pages of blocks in Morton order (module `frames`).

mod additions;
mod checkpoint;
mod description;
mod editor;
mod files;
mod journal;
mod known_file;
mod leftovers;
mod lock;
mod reader;
mod repair;
mod sections;
#[cfg(test)]
mod tests;
mod writer;

pub use additions::join::join_manifests;
pub use additions::sessions::{SessionEntry, StoredEdge, StoredFrame};
pub use checkpoint::{Checkpoint, Checkpoints};
pub use description::details::StoredSettings;
pub use description::manifest::{EditsMark, Manifest, OccupancySummary, SubmapEntry, TsdfSummary};
pub use description::piece::{MapDetails, ScanEntry};
pub use editor::{MapEditor, NewState};
pub use reader::MapStore;
pub use repair::{ManifestState, RepairReport, move_map, repair};
pub use writer::{MapWriter, SaveReport};

/// Version of the map directory's format that this program writes and reads; it reads no other.
pub const FORMAT_VERSION: u32 = 4;
