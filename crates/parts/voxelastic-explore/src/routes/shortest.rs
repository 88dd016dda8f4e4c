//! Shortest paths in a graph (Dijkstra).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// No node.
pub(crate) const NOBODY: u32 = u32::MAX;

/// Lengths of the shortest paths from some nodes to all.
#[derive(Clone, Debug)]
pub(crate) struct Shortest {
    pub lengths: Vec<f64>,
    /// The node before each on its path; [`NOBODY`] for those that the paths begin at, and for those without one.
    pub before: Vec<u32>,
}

impl Shortest {
    /// The nodes on the path to a node, from where it begins.
    pub fn path(&self, node: u32) -> Vec<u32> {
        let before = |node: &u32| Some(self.before[*node as usize]).filter(|before| *before != NOBODY);
        let mut nodes: Vec<u32> = std::iter::successors(Some(node), before).collect();
        nodes.reverse();
        nodes
    }
}

/// The shortest paths among `nodes` nodes that begin at `starts`, each with the length until there; the nearest nodes first, until `is_done` with one: paths to others may be
/// longer than need be, or missing.
pub(crate) fn shortest<I: IntoIterator<Item = (u32, f64)>>(
    nodes: usize,
    starts: impl IntoIterator<Item = (u32, f64)>,
    neighbours: impl Fn(u32) -> I,
    mut is_done: impl FnMut(u32) -> bool,
) -> Shortest {
    let mut found = Shortest { lengths: vec![f64::INFINITY; nodes], before: vec![NOBODY; nodes] };
    let mut heap = BinaryHeap::new();
    for (node, length) in starts {
        if length < found.lengths[node as usize] {
            found.lengths[node as usize] = length;
            heap.push(Reverse((Length(length), node)));
        }
    }
    while let Some(Reverse((Length(length), node))) = heap.pop() {
        if length > found.lengths[node as usize] {
            continue;
        }
        if is_done(node) {
            break;
        }
        for (next, off) in neighbours(node) {
            let length = length + off;
            if length < found.lengths[next as usize] {
                (found.lengths[next as usize], found.before[next as usize]) = (length, node);
                heap.push(Reverse((Length(length), next)));
            }
        }
    }
    found
}

/// A length with a total order.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Length(f64);

impl Eq for Length {}

impl PartialOrd for Length {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Length {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}
