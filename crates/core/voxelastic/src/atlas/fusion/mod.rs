//! Submap fusion (paper Sec. IV-C): one submap becomes part of another.
//!
//! The paper moves every voxel of the source into the target. Scattering voxels forward leaves holes, so this works backward: for every
//! block of the target's lattice that the source reaches, the source is *sampled* at the centres of the target's voxels. There are two
//! steps. [`Sampling`] depends on the source and the transform alone, so it can run in the background; its parts lie in the target's
//! lattice, and [`Merge`] adds them voxel by voxel, a few blocks at a time where integration must not wait:
//!
//! - TSDF: trilinear samples, weighted mean of the distances (observations at a coarser scale count less), weights add up to the cap;
//!   colours of the nearest voxel;
//! - occupancy: log-odds add up and are clamped, unknown stays unknown, free space stays as coarse as it is.
//!
//! [`FusedTsdf`] samples the TSDFs of all submaps in the lattice of the map frame, for a surface without layers; the submaps stay as they are.
//! [`resolve_conflicts`] does the same for single voxels: evidence of all submaps decides where one of them has an isolated hit.

mod alignment;
mod colour;
mod conflicts;
mod fused;
mod merge;
mod occupancy;
mod occupancy_lookup;
mod placement;
mod samples;
mod sampling;
mod settings;
mod tsdf;

pub(crate) use alignment::Corrections;
pub use alignment::PairAgreement;
pub(crate) use alignment::places_on_surface;
pub use conflicts::conflict_resolution::resolve_conflicts;
pub(crate) use conflicts::conflict_resolution::{BlockVotes, add_votes};
pub use fused::combine::Agreement;
pub(crate) use fused::fused_field::FusedField;
pub use fused::fused_tsdf::FusedTsdf;
pub(crate) use fused::live_field::{LiveField, cubes_around, cubes_between};
pub(crate) use fused::sampled_field::{CUBE_SHIFT, Gathered, SampledField};
pub use merge::{Merge, fuse};
pub(crate) use merge::{fuse_from, move_scans};
pub use sampling::{Resampled, Sampling, SamplingPlan};
pub use settings::FusionSettings;
