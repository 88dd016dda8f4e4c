//! What a descent found free, and where in the tree it lies.

use crate::field::occupancy::Summary;
use crate::octree::{Cells, NONE, Octant, Place};

/// Free voxels of a block, a bit each in Morton order: word i is the i-th octant of the block.
pub(super) type Mask = [u64; 8];

/// Where an octant is in the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Spot {
    /// The group of eight that it is one of, or none if it is part of a uniform octant.
    pub group: u32,
    place: u8,
}

impl Spot {
    pub const NOWHERE: Self = Self { group: NONE, place: 0 };

    #[inline(always)]
    pub fn new((group, place): (u32, usize)) -> Self {
        Self { group, place: place as u8 }
    }

    #[inline(always)]
    pub fn is_nowhere(self) -> bool {
        self.group == NONE
    }

    /// Where the octant lies, in the groups of the tree that the spot is of.
    #[inline(always)]
    pub fn within(self, groups: &Cells<'_, [Octant<Summary>; 8]>) -> Place<Octant<Summary>> {
        groups.place(self.group).item(self.place())
    }

    /// Which of the eight it is.
    #[inline(always)]
    pub fn place(self) -> usize {
        usize::from(self.place) % 8
    }
}

/// Something free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Found {
    /// Key of the block, or of the smallest one.
    pub key: u64,
    pub at: Spot,
    /// The block, if there is one.
    pub block: u32,
    pub what: What,
}

/// What is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// A whole uniform octant.
    Octant { level: u8 },
    /// A whole block that holds voxels.
    Block,
    /// Some voxels of a block: which, by the number of their mask, and the coarsest scale that can tell them apart.
    Voxels { mask: u32, scale: u8 },
}

impl Found {
    /// Level of its octant.
    #[inline(always)]
    pub fn level(&self) -> u32 {
        if let What::Octant { level } = self.what { level.into() } else { 0 }
    }
}

/// What a descent found: threads put it on heaps, each on its own, and parts of the tree are stretches of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Finds {
    pub heaps: Vec<Heap>,
    /// In Morton order. They are not joined: that would be a copy of megabytes.
    pub stretches: Vec<Stretch>,
}

/// What one thread found, one part of the tree after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct Heap {
    pub found: Vec<Found>,
    pub masks: Vec<Mask>,
    /// How many uniform octants there are.
    pub octants: usize,
    /// Cubes held against the pyramid, voxels of blocks included.
    pub visited: usize,
}

/// What was found in one part of the tree: the number of the heap, and where on it that is. In Morton order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretch {
    pub heap: u32,
    pub start: u32,
    pub end: u32,
}

impl Finds {
    /// What was found in one part of the tree.
    #[inline(always)]
    pub fn of(&self, stretch: &Stretch) -> &[Found] {
        &self.heaps[stretch.heap as usize].found[stretch.start as usize..stretch.end as usize]
    }
}

impl Heap {
    pub fn clear(&mut self) {
        clear(&mut self.found);
        clear(&mut self.masks);
        (self.octants, self.visited) = (0, 0);
    }
}

/// Empties a list and keeps room for what it had, or somewhat more: not what a scan of unknown space left behind.
pub(super) fn clear<T>(list: &mut Vec<T>) {
    let had = list.len();
    list.clear();
    list.shrink_to(4 * had);
}

/// Marks the `place`-th cube of a block as free: of its quarters, pairs or voxels, by depth.
#[inline(always)]
pub(super) fn note(mask: &mut Mask, place: usize, depth: usize) {
    match depth {
        0 => mask[place] = u64::MAX,
        1 => mask[place / 8] |= 0xff << (8 * (place % 8)),
        _ => mask[place / 64] |= 1 << (place % 64),
    }
}

/// The coarsest scale at which every voxel of a mask is wholly set or wholly clear.
pub(super) fn coarsest_scale(mask: &Mask) -> u8 {
    let whole_words = mask.iter().all(|w| *w == 0 || *w == u64::MAX);
    let whole_bytes = mask.iter().all(|w| w.to_le_bytes().iter().all(|b| *b == 0 || *b == u8::MAX));
    if whole_words { 2 } else { u8::from(whole_bytes) }
}
