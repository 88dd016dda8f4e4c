//! Octants, stored in groups of eight siblings, under a root that grows on demand.

use super::{DisjointMut, NONE, Pool};
use crate::geometry::morton;

/// One cube of space: a link to its children or block, and the field's summary of it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Octant<P> {
    /// At level 0 the block's id, above it the index of the group of eight children; [`NONE`](super::NONE) if it has neither.
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
    /// Key of the root cube's first block, shifted down by `3 * root_level`; meaningless while the tree is empty.
    root_prefix: u64,
}

impl<P: Copy + Default> Default for Octree<P> {
    fn default() -> Self {
        Self { groups: Pool::default(), root: Octant::default(), root_level: 0, root_prefix: 0 }
    }
}

impl<P: Copy + Default> Octree<P> {
    /// A tree of the root cube alone: the one of `level`, 1 to 21, that contains block `key`.
    pub(crate) fn with_root(key: u64, level: u32, payload: P) -> Self {
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

    /// The root octant, mutable.
    pub(crate) fn root_mut(&mut self) -> &mut Octant<P> {
        &mut self.root
    }

    /// Key of the root cube's first block in Morton order.
    pub fn root_key(&self) -> u64 {
        self.root_prefix << (3 * self.root_level)
    }

    /// The eight octants of group `group`.
    #[inline(always)]
    pub fn siblings(&self, group: u32) -> &[Octant<P>; 8] {
        &self.groups[group]
    }

    /// The eight octants of group `group`, mutable.
    #[inline(always)]
    pub(crate) fn siblings_mut(&mut self, group: u32) -> &mut [Octant<P>; 8] {
        &mut self.groups[group]
    }

    /// Borrows all groups for writing to different octants from several threads.
    pub(crate) fn disjoint_mut(&mut self) -> DisjointMut<'_, [Octant<P>; 8]> {
        DisjointMut::new(&mut self.groups)
    }

    /// Adds a group of eight octants, all with `payload` and without links, and returns its index.
    pub(crate) fn add_group(&mut self, payload: P) -> u32 {
        self.groups.insert([Octant { link: NONE, payload }; 8])
    }

    /// Frees group `group`. The caller has unlinked it and everything below.
    pub(crate) fn remove_group(&mut self, group: u32) {
        self.groups.remove(group);
    }

    /// Grows the root until it contains block `key`; existing octants are kept. A new root has the default payload.
    pub(crate) fn grow_to(&mut self, key: u64) {
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

    /// Grows the root until it contains the bounding box of all blocks in `keys`.
    pub(crate) fn grow_over(&mut self, keys: impl Iterator<Item = u64>) {
        let axes = [0, 1, 2].map(|k| morton::AXIS_MASK << k);
        // Masked to the bits of one axis, keys compare as that coordinate does, so they need not be decoded.
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

    /// Whether the root cube contains block `key`.
    #[inline(always)]
    pub fn covers(&self, key: u64) -> bool {
        self.root_level > 0 && key >> (3 * self.root_level) == self.root_prefix
    }

    /// The smallest existing octant that contains block `key`, and its level; none outside of the root.
    pub fn find(&self, key: u64) -> Option<(u32, &Octant<P>)> {
        self.find_at_least(key, 0)
    }

    /// The octant of exactly `level` that contains block `key`, if it exists.
    pub(crate) fn octant_mut(&mut self, key: u64, level: u32) -> Option<&mut Octant<P>> {
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

    /// The smallest existing octant of at least `lowest` level that contains block `key`, and its level.
    pub fn find_at_least(&self, key: u64, lowest: u32) -> Option<(u32, &Octant<P>)> {
        if !self.covers(key) {
            return None;
        }
        let (mut level, mut octant) = (self.root_level, &self.root);
        while level > lowest && octant.link != NONE {
            level -= 1;
            octant = &self.groups[octant.link][(key >> (3 * level)) as usize & 7];
        }
        Some((level, octant))
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

    /// Ids of all blocks in ascending order of their Morton keys.
    pub(crate) fn block_ids(&self) -> Vec<u32> {
        let mut ids = Vec::new();
        self.for_each(|_, level, octant| {
            if level == 0 && octant.link != NONE {
                ids.push(octant.link);
            }
        });
        ids
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.groups.bytes()
    }

    /// Number of octants, including the root.
    pub fn octants(&self) -> usize {
        if self.is_empty() { 0 } else { 1 + 8 * self.groups.live() }
    }
}
