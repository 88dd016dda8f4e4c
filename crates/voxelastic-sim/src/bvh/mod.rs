//! A tree of boxes over the solids of a world, so that a ray or a point meets few of them.

mod build;
mod cast;
mod point;

pub(crate) use build::build;
pub(crate) use cast::{LANES, Packet};

/// A node: a box that holds either two children or a run of solids.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    /// Smallest corner, a millimetre wider than what it holds so that single precision loses nothing.
    min: [f32; 3],
    /// Largest corner, likewise.
    max: [f32; 3],
    /// First of two adjacent children, or first solid of a leaf.
    first: u32,
    /// Solids in a leaf; 0 for an inner node.
    count: u32,
    /// Axis along which the first child comes first.
    axis: u32,
}

/// How much wider than their contents boxes are, metres: far more than the rounding of single precision within a few kilometres.
const SLACK: f32 = 1e-3;

/// Deepest tree that is built, and so the largest stack that a descent needs (it holds one sibling for each level).
const MAX_DEPTH: usize = 60;

/// The tree. Solids are referred to by their place in the world's list, which `build` has put into the order of leaves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
}
