//! Searches for a path, and what makes one shorter.

pub(super) mod kd_tree;
pub(super) mod lattice;
pub(super) mod lattice_search;
pub(super) mod rrt_connect;
pub(super) mod rrt_star;
pub(super) mod sampler;
pub(super) mod shorten;
pub(super) mod stop;
pub(super) mod tree;
