//! A field opened for an update by several threads: each changes blocks of its own, and wakes or makes bricks as it comes to them.

use super::blocks::{Array, Block, TsdfField, owner};
use super::brick::{BRICKS, Brick, Handle, Whereabouts, gather};
use super::pieces::Pieces;
use super::read::assemble;
use super::voxel::Voxel;
use crate::octree::{Batch, Cells, Place, Taking};
use bytemuck::Zeroable;

/// A [`TsdfField`] of which no block is made or removed, but every block can be changed.
pub(crate) struct OpenField<'a> {
    blocks: Cells<'a, Block>,
    bricks: Taking<'a, Brick>,
    pieces: &'a Pieces,
}

/// What threads did to an open field, for [`TsdfField::close`].
#[derive(Debug, Default)]
pub(crate) struct Touched {
    /// Pieces whose bricks were woken.
    woken: Vec<u32>,
    /// Room for further bricks.
    batch: Batch,
}

impl TsdfField {
    /// Opens the field for an update of `blocks` blocks in `shares` shares, after which it is to be [closed](Self::close).
    pub(crate) fn open(&mut self, blocks: usize, shares: usize) -> OpenField<'_> {
        // A block of fine voxels can need all of its bricks; one that changes its scale needs no more.
        let bricks = self.bricks.open(blocks * BRICKS, shares);
        OpenField { blocks: Cells::new(&mut self.blocks), bricks, pieces: &self.pieces }
    }

    /// Closes the field after `taken` bricks were taken, by threads that did what `touched` says.
    pub(crate) fn close(&mut self, taken: usize, touched: Vec<Touched>) {
        let mut woken: Vec<u32> = touched.iter().flat_map(|touched| &touched.woken).copied().collect();
        // The last first: what takes the place of a piece must not be one that goes as well.
        woken.sort_unstable();
        woken.into_iter().rev().for_each(|piece| self.remove_piece(piece));
        self.bricks.close(taken, touched.into_iter().map(|touched| touched.batch));
    }
}

/// Callers promise for all that is unsafe here: no other thread deals with the block meanwhile, and no other reference to it or to its
/// bricks lives.
#[allow(unsafe_code)]
impl OpenField<'_> {
    /// Bricks taken so far.
    pub fn taken(&self) -> usize {
        self.bricks.taken()
    }

    /// Where block `id` lies.
    #[inline(always)]
    pub fn block(&self, id: u32) -> Place<Block> {
        self.blocks.place(id)
    }

    /// The bricks of the current array of `block`; those at rest are nowhere, and those that hold nothing are missing.
    #[inline(always)]
    pub fn bricks(&self, block: &Block) -> [Place<Brick>; BRICKS] {
        let mut places = [Place::NOWHERE; BRICKS];
        for (place, brick) in places.iter_mut().zip(&block.bricks[block.current().bricks()]) {
            // By selection: which bricks a block has is as good as random.
            let awake = self.bricks.cells().place(brick.slot().unwrap_or(0));
            let other = if *brick == Handle::NOWHERE { Place::MISSING } else { Place::NOWHERE };
            *place = if brick.slot().is_some() { awake } else { other };
        }
        places
    }

    /// Brick `brick` of `block`, which is block `id`; woken or made if it has to be.
    ///
    /// # Safety
    /// See above.
    #[cold]
    #[inline(never)]
    pub unsafe fn brick(&self, block: &mut Block, id: u32, brick: usize, touched: &mut Touched) -> Place<Brick> {
        if let Some(slot) = block.bricks[brick].slot() {
            return self.bricks.cells().place(slot);
        }
        let slot = self.bricks.take(owner(id, brick), &mut touched.batch);
        // SAFETY: the slot has just been taken, by this thread.
        let room = unsafe { self.bricks.cells().get(slot) };
        *room = Brick::zeroed();
        if let Whereabouts::Resting(number) = block.bricks[brick].whereabouts() {
            let piece = self.pieces.get(number);
            room.voxels = piece.voxels();
            if block.is_shaded(brick) {
                room.shades = piece.shades();
            }
            touched.woken.push(number);
        }
        block.bricks[brick] = Handle::awake(slot);
        self.bricks.cells().place(slot)
    }

    /// Asks for those bricks of the current array of `block` that are at rest.
    #[inline(always)]
    pub fn ask_for(&self, block: &Block) {
        for brick in &block.bricks[block.current().bricks()] {
            if let Whereabouts::Resting(piece) = brick.whereabouts() {
                self.pieces.ask_for(piece);
            }
        }
    }

    /// Copies an array of `block` into `voxels`, which is as long.
    ///
    /// # Safety
    /// See above.
    pub unsafe fn copy(&self, block: &Block, array: Array, voxels: &mut [Voxel]) {
        // SAFETY: the caller's promise: slots of the block's bricks are its own.
        let awake = |slot| unsafe { &self.bricks.cells().get(slot).voxels };
        assemble(block, array, awake, |piece| self.pieces.get(piece).voxels(), voxels);
    }

    /// Copies the intensities of an array of `block` into `shades`, which is as long.
    ///
    /// # Safety
    /// See above.
    pub unsafe fn copy_shades(&self, block: &Block, scale: usize, shades: &mut [u8]) {
        // SAFETY: as in `copy`.
        let awake = |slot| unsafe { &self.bricks.cells().get(slot).shades };
        assemble(block, Array::Data(scale), awake, |piece| self.pieces.get(piece).shades(), shades);
    }

    /// Makes `voxels` and `shades`, which are zero in a block without intensities, what `array` of `block` holds.
    ///
    /// # Safety
    /// See above.
    pub unsafe fn store(&self, block: &mut Block, id: u32, array: Array, (voxels, shades): (&[Voxel], &[u8]), touched: &mut Touched) {
        for (k, brick) in array.bricks().enumerate() {
            let values = Brick { voxels: gather(voxels, array.scale(), k), shades: gather(shades, array.scale(), k) };
            if values != Brick::zeroed() || block.bricks[brick] != Handle::NOWHERE {
                // SAFETY: the caller's promise.
                *unsafe { self.brick(block, id, brick, touched).get() } = values;
            }
        }
    }
}
