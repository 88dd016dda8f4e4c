//! Something that is not consistent in a map.

use serde::Serialize;
use voxelastic::atlas::SubmapId;
use voxelastic::event::NodeId;

/// What is not consistent, and what would mend it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Suggestion {
    /// What it is, which stays: `closure`, `pair` or `tilt`.
    pub code: &'static str,
    /// In words.
    pub text: String,
    /// A place at which it is seen, metres, in the map.
    pub at: [f64; 3],
    /// The submaps that it is about.
    pub submaps: Vec<SubmapId>,
    /// The scans of a closure; none of others.
    pub scans: Vec<NodeId>,
    /// Places on surfaces at which submaps agree, in the map as it is and with the edit; `null` where the edit was not tried.
    pub places_agree: Option<[u64; 2]>,
    /// What would mend it, as a list of edits has it.
    pub edit: String,
}
