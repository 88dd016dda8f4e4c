//! What submaps contradict each other in, and who is believed.

pub(super) mod conflict_evidence;
pub(super) mod conflict_resolution;
