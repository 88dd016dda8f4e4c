//! A TSDF's blocks: an octree of [`Block`] heads over bricks of voxels, and the moves between scales.
//!
//! A block is integrated at one scale at a time. Going coarser keeps the finer array and remembers what the coarse one
//! started from ([`Array::Past`]); going finer again carries only the difference down, so that detail is never lost.

use super::brick::{BRICKS, Brick, Handle, Whereabouts};
use super::colour::ColourLayer;
use super::packed::PackedArray;
use super::pieces::Pieces;
use super::rest::Recent;
use super::told::Told;
use super::voxel::Voxel;
use crate::octree::{Cursor, NONE, Octree, Pool, SCALES, Slab, voxels_at};
use std::ops::Range;

/// Bricks of all arrays that a block can have.
const HANDLES: usize = BRICKS + 2 * (SCALES - 1);

/// One block of 8 x 8 x 8 finest voxels: where it is and which arrays it holds.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Morton key of its place, see [`crate::octree::block_key`].
    pub key: u64,
    /// The scale at which it is integrated now: the edge of its voxels is 2^scale finest voxels.
    pub scale: u8,
    /// The finest scale for which it holds an array.
    pub finest: u8,
    /// Whether the scans that made it had intensities.
    pub(crate) shaded: bool,
    /// Beams that told it something. Not stored: who goes on with a stored map lets it learn anew.
    pub(crate) told: Told,
    /// When it was last changed, by the field's count of changes.
    pub(super) changed: u32,
    /// The bricks of its arrays, see [`Array::bricks`].
    pub(super) bricks: [Handle; HANDLES],
}

/// One of a block's arrays of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Array {
    /// What the block is made of at a scale, from its finest one to its current one.
    Data(usize),
    /// What the array of a scale coarser than the finest held when the block went up to it. It has no intensities.
    Past(usize),
}

impl Array {
    /// The array's scale.
    #[inline(always)]
    pub fn scale(self) -> usize {
        let (Self::Data(scale) | Self::Past(scale)) = self;
        scale
    }

    /// Which of a block's bricks are the array's.
    #[inline(always)]
    pub fn bricks(self) -> Range<usize> {
        let one = |i: usize| i..i + 1;
        match self {
            Self::Data(0) | Self::Past(0) => 0..BRICKS,
            Self::Data(scale) => one(BRICKS + scale - 1),
            Self::Past(scale) => one(BRICKS + SCALES - 1 + scale - 1),
        }
    }
}

impl Block {
    /// A block that holds nothing.
    pub(crate) fn new(key: u64, scale: u8, finest: u8, shaded: bool) -> Self {
        Self { key, scale, finest, shaded, told: Told::default(), changed: 0, bricks: [Handle::NOWHERE; HANDLES] }
    }

    /// Whether its brick `brick` has intensities.
    #[inline(always)]
    pub(super) fn is_shaded(&self, brick: usize) -> bool {
        self.shaded && brick < BRICKS + SCALES - 1
    }

    /// The array that it is integrated into.
    #[inline(always)]
    pub(crate) fn current(&self) -> Array {
        Array::Data(usize::from(self.scale))
    }
}

/// Room for the largest array of a block.
pub(crate) type VoxelBuffer = [Voxel; voxels_at(0)];

/// A TSDF over an octree of blocks, in a submap's frame.
#[derive(Clone, Debug, Default)]
pub struct TsdfField {
    pub(crate) tree: Octree<()>,
    pub(crate) blocks: Pool<Block>,
    /// Bricks that scans change; each is owned by its block, see [`owner`].
    pub(super) bricks: Slab<Brick>,
    /// Bricks at rest.
    pub(super) pieces: Pieces,
    pub(super) recent: Recent,
    pub(crate) colours: ColourLayer,
}

/// Brick `brick` of block `id`, as the owner of memory.
#[inline(always)]
pub(super) fn owner(id: u32, brick: usize) -> u32 {
    debug_assert!(id >> 28 == 0);
    id << 4 | brick as u32
}

/// Block and brick of an [`owner`].
#[inline(always)]
pub(super) fn owned(owner: u32) -> (u32, usize) {
    (owner >> 4, (owner & 15) as usize)
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
    pub fn ids(&self) -> Range<u32> {
        0..self.blocks.capacity_used()
    }

    /// The id of the block with `key`.
    pub fn find(&self, key: u64) -> Option<u32> {
        self.tree.block(key)
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
        let id = self.blocks.insert(Block::new(key, scale, scale, shaded));
        self.tree.siblings_mut(group)[place].link = id;
        (id, true)
    }

    /// Makes the scale of block `id` one coarser. Its array there, and what that starts from, are to be filled.
    pub(crate) fn go_coarser(&mut self, id: u32) {
        self.blocks[id].scale += 1;
    }

    /// Makes the scale of block `id` one finer. If it had no array there, it is to be filled; the coarser arrays stay until
    /// [`release_coarser`](Self::release_coarser).
    pub(crate) fn go_finer(&mut self, id: u32) {
        let block = &mut self.blocks[id];
        block.scale -= 1;
        block.finest = block.finest.min(block.scale);
    }

    /// Forgets the arrays of block `id` that are coarser than its scale.
    pub(crate) fn release_coarser(&mut self, id: u32) {
        for scale in usize::from(self.blocks[id].scale) + 1..SCALES {
            self.clear(id, Array::Data(scale));
            self.clear(id, Array::Past(scale));
        }
    }

    /// Forgets what `array` of block `id` holds.
    pub(crate) fn clear(&mut self, id: u32, array: Array) {
        for brick in array.bricks() {
            let handle = std::mem::replace(&mut self.blocks[id].bricks[brick], Handle::NOWHERE);
            self.forget(handle);
        }
    }

    /// Gives back what a brick takes.
    pub(super) fn forget(&mut self, handle: Handle) {
        match handle.whereabouts() {
            Whereabouts::Nowhere => {}
            Whereabouts::Awake(slot) => self.bricks.remove(slot),
            Whereabouts::Resting(piece) => self.remove_piece(piece),
        }
    }

    /// Removes a piece whose brick is not there any more.
    pub(super) fn remove_piece(&mut self, piece: u32) {
        if let Some(moved) = self.pieces.remove(piece) {
            let (id, brick) = owned(moved);
            self.blocks[id].bricks[brick] = Handle::resting(piece);
        }
    }

    /// Makes what was packed what `array` of block `id` holds, at rest. It has intensities if it is data and the block has some.
    pub(crate) fn store(&mut self, id: u32, array: Array, packed: &PackedArray) {
        self.clear(id, array);
        for (brick, words) in array.bricks().zip(packed.bricks()).filter(|(_, words)| !words.is_empty()) {
            self.blocks[id].bricks[brick] = Handle::resting(self.pieces.insert(owner(id, brick), words));
        }
    }

    /// Makes what was packed the only array of block `id`, at `scale`.
    pub(crate) fn install(&mut self, id: u32, scale: usize, packed: &PackedArray) {
        (0..SCALES).for_each(|scale| self.clear(id, Array::Data(scale)));
        (1..SCALES).for_each(|scale| self.clear(id, Array::Past(scale)));
        let block = &mut self.blocks[id];
        (block.scale, block.finest, block.shaded) = (scale as u8, scale as u8, packed.is_shaded());
        self.store(id, Array::Data(scale), packed);
    }

    /// Arrays in use at each scale, past ones included.
    pub fn arrays(&self) -> [usize; SCALES] {
        let mut arrays = [0; SCALES];
        for id in self.ids() {
            let (scale, finest) = (usize::from(self.blocks[id].scale), usize::from(self.blocks[id].finest));
            arrays[finest..=scale].iter_mut().for_each(|count| *count += 1);
            arrays[finest + 1..=scale].iter_mut().for_each(|count| *count += 1);
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
        self.tree.bytes() + self.blocks.bytes() + self.bricks.bytes() + self.pieces.bytes() + self.recent.bytes() + self.colours.bytes()
    }

    /// Fails unless every brick that takes memory belongs to an array that its block has.
    #[cfg(test)]
    pub(crate) fn assert_sound(&self) {
        let (mut awake, mut resting) = (0, 0);
        for id in self.ids() {
            let block = self.block(id);
            let (scale, finest) = (usize::from(block.scale), usize::from(block.finest));
            let has = |array: Array| (finest + usize::from(matches!(array, Array::Past(_)))..=scale).contains(&array.scale());
            for array in (0..SCALES).map(Array::Data).chain((1..SCALES).map(Array::Past)) {
                for brick in array.bricks() {
                    let handle = block.bricks[brick];
                    assert!(has(array) || handle == Handle::NOWHERE, "{array:?} of a block at {finest} to {scale}");
                    match handle.whereabouts() {
                        Whereabouts::Nowhere => {}
                        Whereabouts::Awake(slot) => {
                            assert_eq!(self.bricks.owner(slot), Some(owner(id, brick)));
                            awake += 1;
                        }
                        Whereabouts::Resting(_) => resting += 1,
                    }
                }
            }
        }
        assert_eq!([self.bricks.live(), self.pieces.live()], [awake, resting]);
    }
}
