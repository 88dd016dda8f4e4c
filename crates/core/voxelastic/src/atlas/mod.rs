//! Submaps and elasticity (paper Sec. IV): an atlas of rigid submaps whose root poses follow the pose graph.
//!
//! | module | contents |
//! | --- | --- |
//! | [`graph`] | the pose graph and distances along it |
//! | [`passes`] | which links stand for others where a place was passed often |
//! | [`cluster`] | which nodes share a submap, which submaps a closed loop fuses (Sec. IV-A) |
//! | [`fusion`] | fuses one submap into another (Sec. IV-C), resolves conflicts between submaps |
//! | [`laps`] | which submaps are of which lap of a run |
//! | [`overlap`] | how much of a scan a submap already contains |
//! | [`Atlas`], [`Submap`] | the data: fields in submap frames, root poses in the map frame (Sec. IV-D) |
//!
//! The [`mapper`](crate::mapper) decides when each of these runs.

mod assignment;
pub mod cluster;
mod collection;
pub mod fusion;
pub mod graph;
mod laps;
mod node_map;
pub mod overlap;
pub mod passes;
mod submap;

pub use assignment::NodeAssignments;
pub use collection::{Atlas, MergingSubmap};
pub(crate) use laps::ends_lap;
pub use laps::laps;
pub(crate) use node_map::NodeSet;
pub use submap::{Submap, SubmapId, SubmapScan, SurfaceState};
