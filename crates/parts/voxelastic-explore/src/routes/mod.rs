//! How the robot gets there, and home.

pub(super) mod leg;
pub(super) mod retreat;
pub(super) mod roadmap;
pub(super) mod shortcuts;
pub(super) mod shortest;
pub(super) mod track_graph;
pub(super) mod ways;
