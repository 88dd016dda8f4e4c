//! Marching cubes on the dual grid of blocks: from crossed edges to triangles.

pub(super) mod cells;
pub(super) mod colour;
pub(super) mod crossings;
pub(super) mod edge_table;
pub(super) mod mc_table;
pub(super) mod mesh_part;
pub(super) mod triangles;
pub(super) mod vertices;
