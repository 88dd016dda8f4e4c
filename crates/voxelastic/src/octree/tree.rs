//! Octants, eight siblings contiguous, under a root that grows as the scan reaches out.

use super::{Cells, NONE, Pool};
use crate::geometry::morton;

/// One cube of space: what lies below it and what the field says about all of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Octant<P> {
    /// At level 0 the block's id, above it the index of the eight children; [`NONE`] when nothing lies below.
    pub link: u32,
    /// The field's summary of this cube.
    pub payload: P,
}

impl<P: Default> Default for Octant<P> {
    fn default() -> Self {
        Self { link: NONE, payload: P::default() }
    }
}

/// An octree over block keys. Level 0 octants are blocks, a level n octant spans 2^n blocks along each axis.
#[derive(Clone, Debug)]
pub struct Octree<P> {
    pub(super) groups: Pool<[Octant<P>; 8]>,
    root: Octant<P>,
    root_level: u32,
    /// Key of the root cube's smallest block, shifted down by `3 * root_level`; meaningless while the tree is empty.
    root_prefix: u64,
}

impl<P: Copy + Default> Default for Octree<P> {
    fn default() -> Self {
        Self { groups: Pool::default(), root: Octant::default(), root_level: 0, root_prefix: 0 }
    }
}

impl<P: Copy + Default> Octree<P> {
    /// A tree of the root cube alone: the one of `level`, 1 to 21, that holds block `key`.
    pub fn with_root(key: u64, level: u32, payload: P) -> Self {
        Self { groups: Pool::default(), root: Octant { link: NONE, payload }, root_level: level, root_prefix: key >> (3 * level) }
    }

    /// Whether no octant exists.
    pub fn is_empty(&self) -> bool {
        self.root_level == 0
    }

    /// Level of the root: it spans 2^level blocks along each axis; 0 for an empty tree.
    pub fn root_level(&self) -> u32 {
        self.root_level
    }

    /// The root octant.
    pub fn root(&self) -> &Octant<P> {
        &self.root
    }

    /// The root octant.
    pub fn root_mut(&mut self) -> &mut Octant<P> {
        &mut self.root
    }

    /// Key of the root cube's smallest block.
    pub fn root_key(&self) -> u64 {
        self.root_prefix << (3 * self.root_level)
    }

    /// The eight octants of group `group`.
    #[inline(always)]
    pub fn siblings(&self, group: u32) -> &[Octant<P>; 8] {
        &self.groups[group]
    }

    /// The eight octants of group `group`.
    #[inline(always)]
    pub fn siblings_mut(&mut self, group: u32) -> &mut [Octant<P>; 8] {
        &mut self.groups[group]
    }

    /// Opens all groups for writing to different octants from several threads.
    pub fn cells(&mut self) -> Cells<'_, [Octant<P>; 8]> {
        Cells::new(&mut self.groups)
    }

    /// Adds a group of eight octants, all with `payload` and nothing below, and returns its index.
    pub fn add_group(&mut self, payload: P) -> u32 {
        self.groups.insert([Octant { link: NONE, payload }; 8])
    }

    /// Gives group `group` back. The caller has unlinked it and whatever was below.
    pub fn remove_group(&mut self, group: u32) {
        self.groups.remove(group);
    }

    /// Grows the root until it holds `key`; what was there stays below. A new root's payload is the default.
    pub fn grow_to(&mut self, key: u64) {
        if self.is_empty() {
            self.root_level = 1;
            self.root_prefix = key >> 3;
            self.root.link = self.add_group(P::default());
            return;
        }
        while key >> (3 * self.root_level) != self.root_prefix {
            let group = self.add_group(P::default());
            self.groups[group][(self.root_prefix & 7) as usize] = self.root;
            self.root = Octant { link: group, payload: P::default() };
            self.root_prefix >>= 3;
            self.root_level += 1;
        }
    }

    /// Grows the root until it holds all of `keys`, and all blocks between them.
    pub fn grow_over(&mut self, keys: impl Iterator<Item = u64>) {
        let axes = [0, 1, 2].map(|k| morton::EVERY_THIRD << k);
        // The bits of one axis compare as its coordinate does: no key needs to be decoded.
        let (low, high) = keys.fold(([u64::MAX; 3], [0; 3]), |(mut low, mut high), key| {
            for k in 0..3 {
                low[k] = low[k].min(key & axes[k]);
                high[k] = high[k].max(key & axes[k]);
            }
            (low, high)
        });
        if low != [u64::MAX; 3] {
            self.grow_to(low[0] | low[1] | low[2]);
            self.grow_to(high[0] | high[1] | high[2]);
        }
    }

    /// Whether the root cube holds `key`.
    #[inline(always)]
    pub fn covers(&self, key: u64) -> bool {
        self.root_level > 0 && key >> (3 * self.root_level) == self.root_prefix
    }

    /// The smallest existing octant that holds block `key`, and its level; none outside the root.
    pub fn find(&self, key: u64) -> Option<(u32, &Octant<P>)> {
        if !self.covers(key) {
            return None;
        }
        let (mut level, mut octant) = (self.root_level, &self.root);
        while level > 0 && octant.link != NONE {
            level -= 1;
            octant = &self.groups[octant.link][(key >> (3 * level)) as usize & 7];
        }
        Some((level, octant))
    }

    /// The octant of exactly `level` that holds block `key`, if it exists.
    pub fn octant_mut(&mut self, key: u64, level: u32) -> Option<&mut Octant<P>> {
        if !self.covers(key) || level > self.root_level {
            return None;
        }
        if level == self.root_level {
            return Some(&mut self.root);
        }
        let mut group = self.root.link;
        for above in (level + 1..self.root_level).rev() {
            if group == NONE {
                return None;
            }
            group = self.groups[group][(key >> (3 * above)) as usize & 7].link;
        }
        if group == NONE {
            return None;
        }
        Some(&mut self.groups[group][(key >> (3 * level)) as usize & 7])
    }

    /// The id of block `key`, if there is one.
    pub fn block(&self, key: u64) -> Option<u32> {
        match self.find(key) {
            Some((0, octant)) if octant.link != NONE => Some(octant.link),
            _ => None,
        }
    }

    /// Calls `visit(key, level, octant)` for every octant, parents first, siblings in Morton order.
    pub fn for_each(&self, mut visit: impl FnMut(u64, u32, &Octant<P>)) {
        if self.is_empty() {
            return;
        }
        let mut stack = vec![(self.root_key(), self.root_level, self.root)];
        while let Some((key, level, octant)) = stack.pop() {
            visit(key, level, &octant);
            if level > 0 && octant.link != NONE {
                for digit in (0..8u64).rev() {
                    stack.push((key | digit << (3 * (level - 1)), level - 1, self.groups[octant.link][digit as usize]));
                }
            }
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.groups.bytes()
    }

    /// Octants in use, the root included.
    pub fn octants(&self) -> usize {
        if self.is_empty() { 0 } else { 1 + 8 * self.groups.live() }
    }
}
