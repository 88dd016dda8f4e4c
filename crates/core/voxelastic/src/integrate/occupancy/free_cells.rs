//! Free cells: the free octants, blocks and voxels that the descent finds, and where they are in the tree.

use crate::octree::NONE;

/// Free voxels of a block, a bit each in Morton order: word i is the i-th octant of the block.
pub(super) type Mask = [u64; 8];

/// Position of an octant in the tree: a group of eight siblings and the index in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct OctantRef {
    /// The group, or [`NONE`] if the octant does not exist because it is part of a uniform larger one.
    pub group: u32,
    index: u8,
}

impl OctantRef {
    /// An octant that does not exist.
    pub const MISSING: Self = Self { group: NONE, index: 0 };

    #[inline(always)]
    pub fn new((group, index): (u32, usize)) -> Self {
        Self { group, index: index as u8 }
    }

    #[inline(always)]
    pub fn is_missing(self) -> bool {
        self.group == NONE
    }

    /// The group, and the index among its eight siblings.
    #[inline(always)]
    pub fn position(self) -> (u32, usize) {
        (self.group, self.index())
    }

    /// Index among the eight siblings.
    #[inline(always)]
    pub fn index(self) -> usize {
        usize::from(self.index) % 8
    }
}

/// A free cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FreeCell {
    /// Key of the block, or of the first block of an octant.
    pub key: u64,
    pub octant: OctantRef,
    /// The block, or [`NONE`] if there is none.
    pub block: u32,
    pub extent: FreeExtent,
}

/// How much of a cell is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FreeExtent {
    /// A whole uniform octant.
    Octant { level: u8 },
    /// A whole block that has voxels.
    Block,
    /// Some voxels of a block: index of their mask, and the coarsest scale that represents it.
    Voxels { mask: u32, scale: u8 },
}

impl FreeCell {
    /// Level of its octant.
    #[inline(always)]
    pub fn level(&self) -> u32 {
        if let FreeExtent::Octant { level } = self.extent { level.into() } else { 0 }
    }
}

/// All free cells of a scan: each thread appends to a buffer of its own, and a subtree is a range of one buffer.
#[derive(Clone, Debug, Default)]
pub(super) struct FreeCells {
    pub buffers: Vec<ThreadBuffer>,
    /// One range per subtree, in Morton order. The ranges are not concatenated, which would copy megabytes.
    pub ranges: Vec<BufferRange>,
}

/// The free cells found by one thread.
#[derive(Clone, Debug, Default)]
pub(super) struct ThreadBuffer {
    pub cells: Vec<FreeCell>,
    pub masks: Vec<Mask>,
    /// Number of uniform octants among the cells.
    pub octants: usize,
    /// Cubes classified, voxels of blocks included.
    pub visited: usize,
}

/// The free cells of one subtree, in Morton order: `cells[start..end]` of a buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct BufferRange {
    pub buffer: u32,
    pub start: u32,
    pub end: u32,
}

impl FreeCells {
    /// The free cells of one subtree.
    #[inline(always)]
    pub fn of(&self, range: &BufferRange) -> &[FreeCell] {
        &self.buffers[range.buffer as usize].cells[range.start as usize..range.end as usize]
    }
}

impl ThreadBuffer {
    pub fn clear(&mut self) {
        clear(&mut self.cells);
        clear(&mut self.masks);
        (self.octants, self.visited) = (0, 0);
    }
}

/// Empties a list and keeps capacity for four times what it had, so that one scan of much unknown space does not hold its memory for ever.
pub(super) fn clear<T>(list: &mut Vec<T>) {
    let len = list.len();
    list.clear();
    list.shrink_to(4 * len);
}

/// Sets the bits of the `index`-th cube of a block; cubes at depths 0, 1 and 2 are 4, 2 and 1 voxels wide.
#[inline(always)]
pub(super) fn set_cube(mask: &mut Mask, index: usize, depth: usize) {
    match depth {
        0 => mask[index] = u64::MAX,
        1 => mask[index / 8] |= 0xff << (8 * (index % 8)),
        _ => mask[index / 64] |= 1 << (index % 64),
    }
}

/// The coarsest scale at which every voxel of a mask is wholly set or wholly clear.
pub(super) fn coarsest_scale(mask: &Mask) -> u8 {
    let whole_words = mask.iter().all(|w| *w == 0 || *w == u64::MAX);
    let whole_bytes = mask.iter().all(|w| w.to_le_bytes().iter().all(|b| *b == 0 || *b == u8::MAX));
    if whole_words { 2 } else { u8::from(whole_bytes) }
}
