//! A cube of the descent: an octant, or a part of a uniform octant that could be divided.

use super::classify::Classes;
use super::free_cells::{FreeCell, FreeExtent, OctantRef};
use crate::field::occupancy::Summary;
use crate::octree::NONE;

// There is no surface at the limit of the field of view or beside rays without return, so the limit of free space need not be exact there.
/// Cubes of blocks at the limit of the field of view are refined while they are at least this many rays wide.
const RIM_RAYS: u8 = 3;
/// Cubes beside rays without return are refined while they are at least this many rays wide.
const HOLE_RAYS: u8 = 2;

/// A cube that the descent may refine.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cube {
    pub key: u64,
    /// Block coordinates of `key`, kept because they are slow to decode.
    pub corner: [i32; 3],
    pub octant: OctantRef,
    pub link: u32,
    pub level: u8,
    pub summary: Summary,
    /// The cube, or a larger one around it, is free.
    pub free: bool,
    /// A ray passed through its centre, and all rays with a return have theirs beyond it.
    pub crossed: bool,
    /// Least width, in rays, at which the cube is refined; more than 0 at the limit of the field of view and beside rays without return.
    pub min_width: u8,
}

impl Cube {
    #[inline(always)]
    pub fn level(&self) -> u32 {
        u32::from(self.level)
    }

    /// The free cell of the cube.
    #[inline(always)]
    pub fn free_cell(&self, extent: FreeExtent) -> FreeCell {
        let block = if self.level == 0 { self.link } else { NONE };
        FreeCell { key: self.key, octant: self.octant, block, extent }
    }

    /// The free cell of a block that is wholly free.
    pub fn free_block(&self) -> FreeCell {
        self.free_cell(if self.link == NONE { FreeExtent::Octant { level: 0 } } else { FreeExtent::Block })
    }

    /// Key and corner of the `i`-th of its eight children.
    #[inline(always)]
    pub fn child(&self, i: usize) -> (u64, [i32; 3]) {
        let level = self.level() - 1;
        let step = |k: usize| self.corner[k] + ((i as i32 >> k & 1) << level);
        (self.key | (i as u64) << (3 * level), [step(0), step(1), step(2)])
    }
}

/// Least width, in rays, at which child `i` is refined.
#[inline(always)]
pub(super) fn min_width(classes: &Classes, i: usize) -> u8 {
    if classes.rim >> i & 1 == 1 {
        RIM_RAYS
    } else if classes.holed >> i & 1 == 1 {
        HOLE_RAYS
    } else {
        0
    }
}

/// The mixed children that are to be refined if each is `rays` wide.
#[inline(always)]
pub(super) fn children_to_refine(classes: &Classes, rays: f32) -> u8 {
    let mut mixed = classes.mixed;
    if rays < f32::from(RIM_RAYS) {
        mixed &= !classes.rim;
    }
    if rays < f32::from(HOLE_RAYS) {
        mixed &= !classes.holed;
    }
    mixed
}
