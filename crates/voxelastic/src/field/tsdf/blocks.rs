//! A TSDF's blocks: an octree of [`Block`] heads over voxel arrays, and the moves between scales.
//!
//! A block is integrated at one scale at a time. Going coarser keeps the finer array and remembers what the coarse one
//! started from ([`Block::past`]); going finer again carries only the difference down, so that detail is never lost.

use super::colour::ColourLayer;
use super::rest::{COARSEST_PACKED, Resting};
use super::voxel::Voxel;
use crate::field::BlockStore;
use crate::octree::{Cursor, NONE, Octree, Pool, SCALES, voxels_at};
use std::borrow::Cow;

/// One block of 8 x 8 x 8 finest voxels: where it is and which arrays it holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Morton key of its place, see [`crate::octree::block_key`].
    pub key: u64,
    /// The scale at which it is integrated now: the edge of its voxels is 2^scale finest voxels.
    pub scale: u8,
    /// The finest scale for which it holds an array.
    pub finest: u8,
    /// Whether the arrays of the finest scales are at rest: their slots are then those of packed arrays.
    pub(crate) packed: [bool; COARSEST_PACKED + 1],
    /// When it was last changed, by the field's count of changes.
    pub(crate) changed: u32,
    /// Slots of the arrays from `finest` to `scale`.
    pub data: [u32; SCALES],
    /// Slots of what the arrays from `finest + 1` to `scale` held when the block went up to them.
    pub past: [u32; SCALES],
    /// Slots of the intensities belonging to `data`; absent when no scan had any.
    pub shade: [u32; SCALES],
}

impl Block {
    /// A block without arrays.
    pub(crate) fn new(key: u64, scale: u8, finest: u8) -> Self {
        let (packed, none) = ([false; COARSEST_PACKED + 1], [NONE; SCALES]);
        Self { key, scale, finest, packed, changed: 0, data: none, past: none, shade: none }
    }

    /// Whether its array at `scale` is at rest.
    #[inline(always)]
    fn is_packed(&self, scale: usize) -> bool {
        scale <= COARSEST_PACKED && self.packed[scale]
    }
}

/// Room for the largest array of a block.
pub(crate) type VoxelBuffer = [Voxel; voxels_at(0)];

/// A TSDF over an octree of blocks, in a submap's frame.
#[derive(Clone, Debug, Default)]
pub struct TsdfField {
    pub(crate) tree: Octree<()>,
    pub(crate) blocks: Pool<Block>,
    pub(crate) voxels: BlockStore<Voxel>,
    pub(crate) shades: BlockStore<u8>,
    pub(super) resting: Resting,
    pub(crate) colours: ColourLayer,
}

impl TsdfField {
    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.blocks.live()
    }

    /// Whether nothing was ever integrated.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The octree over the blocks.
    pub fn tree(&self) -> &Octree<()> {
        &self.tree
    }

    /// The block with id `id`.
    #[inline(always)]
    pub fn block(&self, id: u32) -> &Block {
        &self.blocks[id]
    }

    /// Ids of all blocks; blocks are never removed from a field, so these are consecutive.
    pub fn ids(&self) -> std::ops::Range<u32> {
        0..self.blocks.capacity_used()
    }

    /// The id of the block with `key`.
    pub fn find(&self, key: u64) -> Option<u32> {
        self.tree.block(key)
    }

    /// The array of `block` at `scale`, unpacked if it is at rest; the scale lies between the block's `finest` and `scale`.
    pub fn voxels(&self, block: &Block, scale: usize) -> Cow<'_, [Voxel]> {
        if block.is_packed(scale) {
            let mut voxels = vec![Voxel::default(); voxels_at(scale)];
            self.resting.arrays[block.data[scale]].unpack(scale, &mut voxels);
            return voxels.into();
        }
        self.voxels.get(scale, block.data[scale]).into()
    }

    /// The array that the block is integrated into, unpacked if it is at rest.
    pub fn current(&self, block: &Block) -> Cow<'_, [Voxel]> {
        self.voxels(block, usize::from(block.scale))
    }

    /// The array that the block is integrated into; none while it is at rest.
    #[inline]
    pub(crate) fn in_place(&self, block: &Block) -> Option<&[Voxel]> {
        let scale = usize::from(block.scale);
        (!block.is_packed(scale)).then(|| self.voxels.get(scale, block.data[scale]))
    }

    /// Voxel `index` of the array that the block is integrated into.
    #[inline]
    pub fn voxel(&self, block: &Block, index: usize) -> Voxel {
        let scale = usize::from(block.scale);
        if block.is_packed(scale) {
            self.resting.arrays[block.data[scale]].voxel(scale, index)
        } else {
            self.voxels.get(scale, block.data[scale])[index]
        }
    }

    /// What the array of `block` at `scale` held when the block became that coarse; finer than `scale` an array exists.
    pub(crate) fn past(&self, block: &Block, scale: usize) -> &[Voxel] {
        self.voxels.get(scale, block.past[scale])
    }

    /// Unpacks the array that the block is integrated into, which is at rest, into the first voxels of `array`.
    pub(crate) fn unpack(&self, block: &Block, array: &mut VoxelBuffer) {
        let scale = usize::from(block.scale);
        self.resting.arrays[block.data[scale]].unpack(scale, &mut array[..voxels_at(scale)]);
    }

    /// Whether the scans that made the block's current array had intensities.
    #[inline(always)]
    pub fn is_shaded(&self, block: &Block) -> bool {
        block.shade[usize::from(block.scale)] != NONE
    }

    /// Intensity of voxel `index` of the array that a block with intensities is integrated into, 1 to 255; 0 where it is unknown.
    #[inline]
    pub fn shade(&self, block: &Block, index: usize) -> u8 {
        let scale = usize::from(block.scale);
        if block.is_packed(scale) {
            self.resting.arrays[block.data[scale]].shade(scale, index)
        } else {
            self.shades.get(scale, block.shade[scale])[index]
        }
    }

    /// Intensities of the array of a block with intensities at `scale`, unpacked if they are at rest.
    pub fn shades(&self, block: &Block, scale: usize) -> Cow<'_, [u8]> {
        if block.is_packed(scale) {
            let mut shades = vec![0; voxels_at(scale)];
            self.resting.arrays[block.data[scale]].unpack_shades(scale, &mut shades);
            return shades.into();
        }
        self.shades.get(scale, block.shade[scale]).into()
    }

    /// Colours of surfaces, where the scans had any.
    pub fn colours(&self) -> &ColourLayer {
        &self.colours
    }

    /// Finds block `key` or makes it at `scale`. The tree's root must cover the key.
    pub(crate) fn make(&mut self, cursor: &mut Cursor, key: u64, scale: u8, shaded: bool) -> (u32, bool) {
        let (group, place) = cursor.make(&mut self.tree, key);
        let link = self.tree.siblings(group)[place].link;
        if link != NONE {
            return (link, false);
        }
        let mut block = Block::new(key, scale, scale);
        block.data[usize::from(scale)] = self.voxels.insert(usize::from(scale));
        if shaded {
            block.shade[usize::from(scale)] = self.shades.insert(usize::from(scale));
        }
        let id = self.blocks.insert(block);
        self.tree.siblings_mut(group)[place].link = id;
        (id, true)
    }

    /// Hangs `block`, whose key is not there yet, into the tree and returns its id. The tree's root must cover the key.
    pub(in crate::field) fn hang(&mut self, cursor: &mut Cursor, block: Block) -> u32 {
        let (group, place) = cursor.make(&mut self.tree, block.key);
        let id = self.blocks.insert(block);
        self.tree.siblings_mut(group)[place].link = id;
        id
    }

    /// Allocates what block `id` needs to be integrated one scale coarser and makes that its scale.
    pub(crate) fn reserve_coarser(&mut self, id: u32) {
        let block = &mut self.blocks[id];
        let scale = usize::from(block.scale) + 1;
        block.data[scale] = self.voxels.insert(scale);
        block.past[scale] = self.voxels.insert(scale);
        if block.shade[scale - 1] != NONE {
            block.shade[scale] = self.shades.insert(scale);
        }
        block.scale = scale as u8;
    }

    /// Allocates what block `id` needs to be integrated one scale finer and makes that its scale. The coarser arrays
    /// stay until [`release_coarser`](Self::release_coarser).
    pub(crate) fn reserve_finer(&mut self, id: u32) {
        let block = &mut self.blocks[id];
        let scale = usize::from(block.scale) - 1;
        if block.data[scale] == NONE {
            block.data[scale] = self.voxels.insert(scale);
            block.finest = scale as u8;
            if block.shade[scale + 1] != NONE {
                block.shade[scale] = self.shades.insert(scale);
            }
        }
        block.scale = scale as u8;
    }

    /// Frees the arrays coarser than the block's scale.
    pub(crate) fn release_coarser(&mut self, id: u32) {
        let block = &mut self.blocks[id];
        for scale in usize::from(block.scale) + 1..SCALES {
            for slot in [&mut block.data[scale], &mut block.past[scale]] {
                if *slot != NONE {
                    self.voxels.remove(scale, *slot);
                    *slot = NONE;
                }
            }
            if block.shade[scale] != NONE {
                self.shades.remove(scale, block.shade[scale]);
                block.shade[scale] = NONE;
            }
        }
    }

    /// Arrays in use at each scale, past ones included and those at rest.
    pub fn arrays(&self) -> [usize; SCALES] {
        let mut arrays = self.voxels.live();
        for id in self.ids() {
            self.blocks[id].packed.iter().zip(&mut arrays).for_each(|(&packed, count)| *count += usize::from(packed));
        }
        arrays
    }

    /// Blocks integrated at each scale.
    pub fn blocks_by_scale(&self) -> [usize; SCALES] {
        let mut counts = [0; SCALES];
        self.ids().for_each(|id| counts[usize::from(self.blocks[id].scale)] += 1);
        counts
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.tree.bytes() + self.blocks.bytes() + self.voxels.bytes() + self.shades.bytes() + self.resting.bytes() + self.colours.bytes()
    }
}
