//! A finger into the octree: looking up keys in Morton order costs a step or two each instead of a whole descent.

use super::{NONE, Octree};
use crate::geometry::morton::AXIS_BITS;

/// Remembers the path to the last key looked up. A cursor is only good for the tree it was made for, and only until
/// groups are removed from it or its root grows.
#[derive(Clone, Debug)]
pub struct Cursor {
    /// `path[k]` is the group that holds the level k octant of `key`; valid for `low <= k < root_level`.
    path: [u32; AXIS_BITS as usize + 1],
    key: u64,
    low: u32,
    top: u32,
}

impl Cursor {
    /// A cursor at the root of `tree`.
    pub fn new<P: Copy + Default>(tree: &Octree<P>) -> Self {
        let top = tree.root_level();
        let mut path = [NONE; AXIS_BITS as usize + 1];
        if top > 0 {
            path[top as usize - 1] = tree.root().link;
        }
        Self { path, key: tree.root_key(), low: top.saturating_sub(1), top }
    }

    /// Level of the lowest group on the remembered path that `key` shares.
    #[inline(always)]
    fn shared_level(&self, key: u64) -> u32 {
        let differing = key ^ self.key;
        let level = if differing == 0 { 0 } else { (63 - differing.leading_zeros()) / 3 };
        level.max(self.low)
    }

    /// The block-level octant of `key` as (group, place in it); octants on the way are made, with `payload` inherited
    /// from the octant that they split. The tree's root must cover `key`.
    #[inline]
    pub fn make<P: Copy + Default>(&mut self, tree: &mut Octree<P>, key: u64) -> (u32, usize) {
        self.make_at(tree, key, 0)
    }

    /// As [`make`](Self::make), for the octant of `lowest` level (below the root's).
    #[inline]
    pub fn make_at<P: Copy + Default>(&mut self, tree: &mut Octree<P>, key: u64, lowest: u32) -> (u32, usize) {
        debug_assert!(tree.covers(key) && tree.root_level() == self.top && lowest < self.top);
        let mut level = self.shared_level(key).max(lowest);
        let mut group = self.path[level as usize];
        while level > lowest {
            let place = (key >> (3 * level)) as usize & 7;
            let octant = tree.groups[group][place];
            let mut below = octant.link;
            if below == NONE {
                below = tree.add_group(octant.payload);
                tree.groups[group][place].link = below;
            }
            group = below;
            level -= 1;
            self.path[level as usize] = group;
        }
        self.key = key;
        self.low = lowest;
        (group, (key >> (3 * lowest)) as usize & 7)
    }

    /// The octant of `lowest` level (below the root's) that holds block `key`, as (group, place in it), if it exists.
    #[inline]
    pub fn find_at<P: Copy + Default>(&mut self, tree: &Octree<P>, key: u64, lowest: u32) -> Option<(u32, usize)> {
        if !tree.covers(key) {
            return None;
        }
        let mut level = self.shared_level(key).max(lowest);
        let mut group = self.path[level as usize];
        self.key = key;
        while level > lowest {
            let below = tree.siblings(group)[(key >> (3 * level)) as usize & 7].link;
            if below == NONE {
                self.low = level;
                return None;
            }
            group = below;
            level -= 1;
            self.path[level as usize] = group;
        }
        self.low = lowest;
        Some((group, (key >> (3 * lowest)) as usize & 7))
    }

    /// The id of block `key`, if there is one.
    #[inline]
    pub fn block<P: Copy + Default>(&mut self, tree: &Octree<P>, key: u64) -> Option<u32> {
        let (group, place) = self.find_at(tree, key, 0)?;
        let link = tree.siblings(group)[place].link;
        (link != NONE).then_some(link)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{block_coords, block_key};
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn coords() -> impl Strategy<Value = Vec<[i32; 3]>> {
        let near = prop::array::uniform3(-20i32..20);
        let far = prop::array::uniform3(-600_000i32..600_000);
        prop::collection::vec(prop_oneof![4 => near, 1 => far], 1..200)
    }

    proptest! {
        #[test]
        fn tree_and_cursor_equal_a_sorted_map(blocks in coords(), probes in coords()) {
            let mut tree = Octree::<u8>::default();
            let mut slow = BTreeMap::new();
            for (id, &c) in blocks.iter().enumerate() {
                let key = block_key(c);
                prop_assert_eq!(block_coords(key), c);
                tree.grow_to(key);
                let (group, place) = Cursor::new(&tree).make(&mut tree, key);
                tree.siblings_mut(group)[place].link = id as u32;
                slow.insert(key, id as u32);
            }
            let mut cursor = Cursor::new(&tree);
            for c in blocks.iter().chain(&probes) {
                let key = block_key(*c);
                prop_assert_eq!(tree.block(key), slow.get(&key).copied());
                prop_assert_eq!(cursor.block(&tree, key), slow.get(&key).copied());
            }
            let mut seen = Vec::new();
            tree.for_each(|key, level, octant| if level == 0 && octant.link != NONE { seen.push((key, octant.link)) });
            prop_assert_eq!(seen, slow.into_iter().collect::<Vec<_>>());
        }

        #[test]
        fn a_tree_grows_over_all_blocks_at_once_as_one_by_one(blocks in coords()) {
            let mut tree = Octree::<u8>::default();
            tree.grow_over(blocks.iter().map(|&c| block_key(c)));
            let mut slow = Octree::<u8>::default();
            blocks.iter().for_each(|&c| slow.grow_to(block_key(c)));
            prop_assert!(blocks.iter().all(|&c| tree.covers(block_key(c))));
            prop_assert_eq!((tree.root_level(), tree.root_key()), (slow.root_level(), slow.root_key()));
        }

        #[test]
        fn a_cursor_that_makes_octants_in_any_order_finds_them_again(blocks in coords()) {
            let mut tree = Octree::<u8>::default();
            blocks.iter().for_each(|&c| tree.grow_to(block_key(c)));
            let mut cursor = Cursor::new(&tree);
            for (id, &c) in blocks.iter().enumerate() {
                let (group, place) = cursor.make(&mut tree, block_key(c));
                tree.siblings_mut(group)[place].link = id as u32;
            }
            for (id, &c) in blocks.iter().enumerate() {
                let last = blocks.iter().rposition(|&b| b == c).unwrap_or(id);
                prop_assert_eq!(tree.block(block_key(c)), Some(last as u32));
                let level = id as u32 % tree.root_level();
                let expected = tree.octant_mut(block_key(c), level).map(|octant| *octant);
                let found = cursor.find_at(&tree, block_key(c), level);
                prop_assert_eq!(found.map(|(group, place)| tree.siblings(group)[place]), expected);
            }
        }
    }
}
