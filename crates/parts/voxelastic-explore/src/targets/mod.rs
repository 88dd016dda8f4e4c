//! What is not known yet, from where it can be seen, and which of these places is next.

pub(super) mod choice;
pub(super) mod clusters;
pub(super) mod columns;
pub(super) mod frontier;
pub(super) mod frontiers;
pub(super) mod gain;
pub(super) mod tour;
pub(super) mod viewpoints;
