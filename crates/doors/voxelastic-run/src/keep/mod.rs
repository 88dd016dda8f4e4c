//! What is kept of a run on disk: its map, and meanwhile what is needed to go on after it was killed.
//!
//! While a run goes on, a [`Keeper`] writes checkpoints beside the map. Each has what is needed to go on as if nothing had happened: the submaps, what the
//! mapper and the odometry know beside them, the place in the input, and a journal of the poses and edges that came, by which loop closures and
//! optimisation are brought back to where they were.

mod every;
mod identity;
mod keeper;
mod record;
mod resume;
mod state;
mod target;
mod unfinished;

pub use every::CheckpointEvery;
pub use identity::Identity;
pub(crate) use keeper::details;
pub use keeper::{CheckpointSummary, Keeper, Stages};
pub use resume::Resume;
pub use target::{OnFullDisk, SaveOptions, Target, path};
pub use unfinished::Unfinished;

/// Whether what comes to a run comes again, if it is gone on with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comes {
    /// It is read again, from where the run was.
    Again,
    /// A program pushes what follows, from where the run was.
    InOrder,
    /// It is what a robot delivers then, which may be elsewhere: its first scans are found in the map.
    Once,
}
