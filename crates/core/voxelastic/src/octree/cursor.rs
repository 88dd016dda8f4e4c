//! A finger into the octree: looking up keys in Morton order takes a step or two each instead of a whole descent.

use super::{NONE, Octree};
use crate::geometry::morton::AXIS_BITS;

/// Caches the path to the last key looked up. A cursor is valid only for the tree it was made for, and only until
/// groups are removed from that tree or its root grows.
#[derive(Clone, Debug)]
pub(crate) struct Cursor {
    /// `path[k]` is the group that contains the level k octant of `key`; valid for `low <= k < root_level`.
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

    /// Level of the lowest group on the cached path that `key` shares.
    #[inline(always)]
    fn shared_level(&self, key: u64) -> u32 {
        let differing = key ^ self.key;
        let level = if differing == 0 { 0 } else { (63 - differing.leading_zeros()) / 3 };
        level.max(self.low)
    }

    /// The block-level octant of `key` as (group, index in it). Missing octants are created, each with the payload of the octant that
    /// it splits. The tree's root must cover `key`.
    #[inline]
    pub fn find_or_create<P: Copy + Default>(&mut self, tree: &mut Octree<P>, key: u64) -> (u32, usize) {
        self.find_or_create_at(tree, key, 0)
    }

    /// As [`find_or_create`](Self::find_or_create), for the octant of level `lowest` (below the root's).
    #[inline]
    pub fn find_or_create_at<P: Copy + Default>(&mut self, tree: &mut Octree<P>, key: u64, lowest: u32) -> (u32, usize) {
        debug_assert!(tree.covers(key) && tree.root_level() == self.top && lowest < self.top);
        let mut level = self.shared_level(key).max(lowest);
        let mut group = self.path[level as usize];
        while level > lowest {
            let index = (key >> (3 * level)) as usize & 7;
            let octant = tree.groups[group][index];
            let mut children = octant.link;
            if children == NONE {
                children = tree.add_group(octant.payload);
                tree.groups[group][index].link = children;
            }
            group = children;
            level -= 1;
            self.path[level as usize] = group;
        }
        self.key = key;
        self.low = lowest;
        (group, (key >> (3 * lowest)) as usize & 7)
    }

    /// The octant of level `lowest` (below the root's) that contains block `key`, as (group, index in it), if it exists.
    #[inline]
    pub fn find_at<P: Copy + Default>(&mut self, tree: &Octree<P>, key: u64, lowest: u32) -> Option<(u32, usize)> {
        if !tree.covers(key) {
            return None;
        }
        let mut level = self.shared_level(key).max(lowest);
        let mut group = self.path[level as usize];
        self.key = key;
        while level > lowest {
            let children = tree.siblings(group)[(key >> (3 * level)) as usize & 7].link;
            if children == NONE {
                self.low = level;
                return None;
            }
            group = children;
            level -= 1;
            self.path[level as usize] = group;
        }
        self.low = lowest;
        Some((group, (key >> (3 * lowest)) as usize & 7))
    }

    /// The id of block `key`, if it exists.
    #[inline]
    pub fn block<P: Copy + Default>(&mut self, tree: &Octree<P>, key: u64) -> Option<u32> {
        let (group, index) = self.find_at(tree, key, 0)?;
        let link = tree.siblings(group)[index].link;
        (link != NONE).then_some(link)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{block_coords, block_key};
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
                let (group, index) = Cursor::new(&tree).find_or_create(&mut tree, key);
                tree.siblings_mut(group)[index].link = id as u32;
                slow.insert(key, id as u32);
            }
            let mut cursor = Cursor::new(&tree);
            for c in blocks.iter().chain(&probes) {
                let key = block_key(*c);
                prop_assert_eq!(tree.block(key), slow.get(&key).copied());
                prop_assert_eq!(cursor.block(&tree, key), slow.get(&key).copied());
            }
            let mut visited = Vec::new();
            tree.for_each(|key, level, octant| if level == 0 && octant.link != NONE { visited.push((key, octant.link)) });
            prop_assert_eq!(visited, slow.into_iter().collect::<Vec<_>>());
        }

        #[test]
        fn growing_over_all_blocks_equals_growing_one_by_one(blocks in coords()) {
            let mut tree = Octree::<u8>::default();
            tree.grow_over(blocks.iter().map(|&c| block_key(c)));
            let mut slow = Octree::<u8>::default();
            blocks.iter().for_each(|&c| slow.grow_to(block_key(c)));
            prop_assert!(blocks.iter().all(|&c| tree.covers(block_key(c))));
            prop_assert_eq!((tree.root_level(), tree.root_key()), (slow.root_level(), slow.root_key()));
        }

        #[test]
        fn octants_created_through_a_cursor_are_found_again(blocks in coords()) {
            let mut tree = Octree::<u8>::default();
            blocks.iter().for_each(|&c| tree.grow_to(block_key(c)));
            let mut cursor = Cursor::new(&tree);
            for (id, &c) in blocks.iter().enumerate() {
                let (group, index) = cursor.find_or_create(&mut tree, block_key(c));
                tree.siblings_mut(group)[index].link = id as u32;
            }
            for (id, &c) in blocks.iter().enumerate() {
                let last = blocks.iter().rposition(|&b| b == c).unwrap_or(id);
                prop_assert_eq!(tree.block(block_key(c)), Some(last as u32));
                let level = id as u32 % tree.root_level();
                let expected = tree.octant_mut(block_key(c), level).map(|octant| *octant);
                let found = cursor.find_at(&tree, block_key(c), level);
                prop_assert_eq!(found.map(|(group, index)| tree.siblings(group)[index]), expected);
            }
        }
    }
}
