//! Nodes of the hierarchy.

/// A node: a box around two children or a range of solids.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    /// Smallest corner, extended by [`SLACK`].
    pub min: [f32; 3],
    /// Largest corner, likewise.
    pub max: [f32; 3],
    /// First of two adjacent children, or first solid of a leaf.
    pub first: u32,
    /// Number of solids of a leaf; 0 for an inner node.
    pub count: u32,
    /// Axis along which the first child comes before the second.
    pub axis: u32,
}

/// Margin of the boxes, metres: far more than the rounding of single precision within a few kilometres.
pub(super) const SLACK: f32 = 1e-3;

/// Greatest depth of the tree, which bounds the stack of a traversal (one sibling per level).
pub(super) const MAX_DEPTH: usize = 60;

/// The hierarchy. Leaves refer to ranges of solids in the order returned by [`SolidBvh::build`].
#[derive(Clone, Debug, Default)]
pub(crate) struct SolidBvh {
    pub(super) nodes: Vec<Node>,
}
