//! Tables by node for searches of the pose graph, which look up most of their time.

use crate::event::NodeId;
use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

/// A table by node.
pub type NodeMap<T> = HashMap<NodeId, T, BuildHasherDefault<NodeHasher>>;
/// A set of nodes.
pub type NodeSet = HashSet<NodeId, BuildHasherDefault<NodeHasher>>;

/// Spreads the numbers of nodes over all bits by a multiplication. No protection against numbers that are chosen to collide: whoever chooses those of his scans
/// makes his own map slow.
#[derive(Clone, Copy, Debug, Default)]
pub struct NodeHasher(u64);

impl Hasher for NodeHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u64(u64::from(*byte)));
    }

    fn write_u64(&mut self, number: u64) {
        // 2^64 divided by the golden ratio; tables take the lowest and the highest bits.
        let product = u128::from(self.0 ^ number) * 0x9e37_79b9_7f4a_7c15;
        self.0 = (product >> 64) as u64 ^ product as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::hash::BuildHasher;

    #[test]
    fn numbers_in_a_row_and_in_steps_fall_into_different_places() {
        let hash = |node: NodeId| BuildHasherDefault::<NodeHasher>::default().hash_one(node);
        for step in [1, 2, 10, 1000, 1 << 20, 1 << 32, 1 << 48] {
            let places = |bits: fn(u64) -> u64| (0..1024).map(|k| bits(hash(k * step))).collect::<HashSet<u64>>().len();
            // As many as of random numbers: 1 - 1/e of the places.
            assert!(places(|hash| hash % 1024) > 500, "step {step}: {}", places(|hash| hash % 1024));
            assert!(places(|hash| hash >> 57) > 100, "step {step}: {}", places(|hash| hash >> 57));
        }
    }
}
