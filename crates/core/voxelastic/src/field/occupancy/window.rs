//! A small box of an occupancy field as an array of blocks for many lookups: the octree is descended once, not once per voxel.

use super::{OccupancyField, Summary, UNKNOWN};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, SCALES, block_coords, voxel_coords, voxel_index};

/// Bits of a finest voxel's index in its block.
const VOXEL_BITS: u32 = 3 * BLOCK_SHIFT;

/// Bits of the children on the low side along each axis.
const LOW_SIDE: [u8; 3] = [0b0101_0101, 0b0011_0011, 0b0000_1111];

/// A box of whole blocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockBox {
    low: [i32; 3],
    high: [i32; 3],
}

impl BlockBox {
    /// The blocks of the finest voxels from `low` to `high`, both included.
    #[inline(always)]
    pub fn of_voxels(low: [i32; 3], high: [i32; 3]) -> Self {
        Self { low: low.map(|v| v >> BLOCK_SHIFT), high: high.map(|v| v >> BLOCK_SHIFT) }
    }

    /// Whether any block or octant in the box has a maximum above `least`.
    pub fn contains_above(&self, least: i8, field: &OccupancyField) -> bool {
        self.visit_leaves(field, &mut |summary| summary.max > least, &mut |_| true)
    }

    /// Visits the leaves in the box below octants for which `is_wanted` holds, in Morton order, until `visit` returns true; returns whether it did.
    pub fn visit_leaves<'a>(
        &self,
        field: &'a OccupancyField,
        is_wanted: &mut impl FnMut(&Summary) -> bool,
        visit: &mut impl FnMut(OctreeLeaf<'a>) -> bool,
    ) -> bool {
        let tree = field.tree();
        let (corner, level) = (block_coords(tree.root_key()), tree.root_level());
        let is_outside = (0..3).any(|k| self.high[k] < corner[k] || self.low[k] >= corner[k] + (1 << level));
        !tree.is_empty() && !is_outside && self.visit_below(field, OctreeLeaf { octant: tree.root(), corner, level }, is_wanted, visit)
    }

    fn visit_below<'a>(
        &self,
        field: &'a OccupancyField,
        at: OctreeLeaf<'a>,
        is_wanted: &mut impl FnMut(&Summary) -> bool,
        visit: &mut impl FnMut(OctreeLeaf<'a>) -> bool,
    ) -> bool {
        if !is_wanted(&at.octant.payload) {
            return false;
        }
        if at.octant.link == NONE || at.level == 0 {
            return visit(at);
        }
        let half = 1 << (at.level - 1);
        let mut reached = 0xff_u8;
        for (k, low_side) in LOW_SIDE.into_iter().enumerate() {
            reached &= if self.high[k] < at.corner[k] + half { low_side } else { 0xff };
            reached &= if self.low[k] >= at.corner[k] + half { !low_side } else { 0xff };
        }
        let children = field.tree().siblings(at.octant.link);
        (0..8).filter(|i| reached >> i & 1 == 1).any(|i| {
            let corner = std::array::from_fn(|k| at.corner[k] + (i >> k & 1) * half);
            self.visit_below(field, OctreeLeaf { octant: &children[i as usize], corner, level: at.level - 1 }, is_wanted, visit)
        })
    }
}

/// A leaf of the octree: a block, or a cube with one value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OctreeLeaf<'a> {
    pub octant: &'a Octant<Summary>,
    /// Coordinates of its first block.
    pub corner: [i32; 3],
    pub level: u32,
}

/// The voxels of a block; a single value is a block at the coarsest scale.
#[derive(Clone, Copy, Debug)]
struct Cell<'a> {
    values: &'a [i8],
    scale: u8,
    is_block: bool,
}

impl Cell<'_> {
    const EMPTY: Self = Cell { values: &[UNKNOWN], scale: SCALES as u8 - 1, is_block: false };
}

/// What a window has where a block would be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CellContent {
    /// One value.
    Uniform(i8),
    /// A block at this scale.
    Block(usize),
}

/// The voxels of a box of blocks.
#[derive(Debug)]
pub(crate) struct OccupancyWindow<'a> {
    low: [i32; 3],
    size: [usize; 3],
    cells: Vec<Cell<'a>>,
}

impl<'a> OccupancyWindow<'a> {
    /// A window on those blocks of `field` whose maximum is above `least` ([`UNKNOWN`]: all with any observation); others count as
    /// unknown. None if there is no such block.
    pub fn new(field: &'a OccupancyField, blocks: &BlockBox, least: i8) -> Option<Self> {
        let BlockBox { low, high } = *blocks;
        let size = std::array::from_fn(|k| (high[k] - low[k] + 1).max(0) as usize);
        let mut window = Self { low, size, cells: Vec::new() };
        blocks.visit_leaves(field, &mut |summary| summary.max > least, &mut |leaf| {
            window.insert(field, leaf, high);
            false
        });
        (!window.cells.is_empty()).then_some(window)
    }

    fn insert(&mut self, field: &'a OccupancyField, leaf: OctreeLeaf<'a>, high: [i32; 3]) {
        if self.cells.is_empty() {
            self.cells.resize(self.size.iter().product(), Cell::EMPTY);
        }
        let cell = if leaf.octant.link == NONE {
            Cell { values: std::slice::from_ref(&leaf.octant.payload.value), ..Cell::EMPTY }
        } else {
            let block = field.block(leaf.octant.link);
            Cell { values: field.values(block), scale: block.scale, is_block: true }
        };
        let range = |k: usize| leaf.corner[k].max(self.low[k]) - self.low[k]..(leaf.corner[k] + (1 << leaf.level)).min(high[k] + 1) - self.low[k];
        let [nx, ny, _] = self.size;
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    self.cells[x as usize + nx * (y as usize + ny * z as usize)] = cell;
                }
            }
        }
    }

    /// The value of all voxels in the blocks of the window within a box, if all are equal; [`UNKNOWN`] if there are none.
    pub fn uniform_in(&self, blocks: &BlockBox) -> Option<i8> {
        let range = |k: usize| (blocks.low[k] - self.low[k]).max(0)..(blocks.high[k] + 1 - self.low[k]).min(self.size[k] as i32);
        let [nx, ny, _] = self.size;
        let mut value = None;
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let values = self.cells[x as usize + nx * (y as usize + ny * z as usize)].values;
                    if values.len() > 1 || value.is_some_and(|v| v != values[0]) {
                        return None;
                    }
                    value = Some(values[0]);
                }
            }
        }
        Some(value.unwrap_or(UNKNOWN))
    }

    /// Visits what the window has in a box, until `visit` returns true.
    #[inline(always)]
    pub fn visit(&self, blocks: &BlockBox, mut visit: impl FnMut(CellContent) -> bool) {
        let range = |k: usize| (blocks.low[k] - self.low[k]).max(0)..(blocks.high[k] + 1 - self.low[k]).min(self.size[k] as i32);
        let [nx, ny, _] = self.size;
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let cell = &self.cells[x as usize + nx * (y as usize + ny * z as usize)];
                    let content = if cell.is_block { CellContent::Block(cell.scale.into()) } else { CellContent::Uniform(cell.values[0]) };
                    if visit(content) {
                        return;
                    }
                }
            }
        }
    }

    /// Whether any block of the window touches the finest voxels from `low` to `high`, both included.
    pub fn has_blocks_in(&self, low: [i32; 3], high: [i32; 3]) -> bool {
        let block = |c: i32, k: usize| (c >> BLOCK_SHIFT) - self.low[k];
        let range = |k: usize| block(low[k], k).max(0)..block(high[k], k).saturating_add(1).min(self.size[k] as i32);
        let [nx, ny, _] = self.size;
        let is_known = |x: i32, y: i32, z: i32| self.cells[x as usize + nx * (y as usize + ny * z as usize)].values != [UNKNOWN];
        range(2).any(|z| range(1).any(|y| range(0).any(|x| is_known(x, y, z))))
    }

    /// Value of the finest voxel at `c`; [`UNKNOWN`] outside the window.
    #[inline(always)]
    pub fn value(&self, c: [i32; 3]) -> i8 {
        let [x, y, z] = std::array::from_fn(|k| ((c[k] >> BLOCK_SHIFT) - self.low[k]) as usize);
        let [nx, ny, nz] = self.size;
        if x >= nx || y >= ny || z >= nz {
            debug_assert!(false, "lookup outside the window");
            return UNKNOWN;
        }
        let cell = self.cells[x + nx * (y + ny * z)];
        cell.values[voxel_index(c.map(|v| (v & (BLOCK_EDGE as i32 - 1)) as usize >> cell.scale), usize::from(cell.scale))]
    }

    /// Where the finest voxel around the point `p` (finest voxels) is, for [`value_at`](Self::value_at). Without branches and casts, so that it vectorises.
    #[inline(always)]
    pub fn place(&self, p: [f32; 3]) -> u32 {
        // 2^23: from here on, adjacent floats differ by one.
        const ONES: f32 = 8_388_608.0;
        let [nx, ny, _] = self.size.map(|n| n as u32);
        // Whole numbers below 2^24, so that the difference is exact.
        let from_corner: [f32; 3] = std::array::from_fn(|k| p[k].floor() - (self.low[k] << BLOCK_SHIFT) as f32);
        let is_inside = |k: usize| (from_corner[k] >= 0.0) & (from_corner[k] < (self.size[k] << BLOCK_SHIFT) as f32);
        let [x, y, z] = from_corner.map(|c| (c + ONES).to_bits() & 0x007f_ffff);
        let [i, j, k] = [x, y, z].map(|c| c >> BLOCK_SHIFT);
        let cell = i.wrapping_add(nx.wrapping_mul(j.wrapping_add(ny.wrapping_mul(k))));
        let [i, j, k] = [x, y, z].map(|c| c & (BLOCK_EDGE as u32 - 1));
        let place = cell << VOXEL_BITS | i | j << BLOCK_SHIFT | k << (2 * BLOCK_SHIFT);
        if is_inside(0) & is_inside(1) & is_inside(2) { place } else { u32::MAX }
    }

    /// Value of the voxel at a [`place`](Self::place); [`UNKNOWN`] outside the window.
    #[inline(always)]
    pub fn value_at(&self, place: u32) -> i8 {
        let Some(cell) = self.cells.get((place >> VOXEL_BITS) as usize) else {
            debug_assert!(false, "lookup outside the window");
            return UNKNOWN;
        };
        let scale = usize::from(cell.scale);
        cell.values[voxel_index(voxel_coords(place as usize & ((1 << VOXEL_BITS) - 1), 0).map(|v| v >> scale), scale)]
    }
}
