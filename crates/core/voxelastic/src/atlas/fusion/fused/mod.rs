//! The TSDFs of all submaps as one field.

pub(super) mod combine;
pub(super) mod fused_field;
pub(super) mod fused_tsdf;
pub(super) mod live_field;
pub(super) mod sampled_field;
