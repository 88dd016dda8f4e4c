//! Compaction: bricks that no recent scan changed move to the [compressed store](crate::field::tsdf::storage::compressed_store). A scan that
//! writes to one decodes it again, see [`writer`](crate::field::tsdf::writer).

use super::brick_codec::EncodedBrick;
use crate::field::tsdf::block::{block_and_brick, owner};
use crate::field::tsdf::brick::{Brick, BrickHandle};
use crate::field::tsdf::field::TsdfField;
use crate::memory::{PageVec, is_tight};
use crate::octree::{Slab, prefetch_item};
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Number of scans after which a block that none of them changed is compressed.
const RECENT_CHANGES: usize = 8;
/// Largest number of blocks compressed after one scan: the work is not urgent, so it is spread over scans.
const MAX_BLOCKS_PER_SCAN: usize = 2048;
/// Above this number of uncompressed bricks, 42 MB, and where memory is short, the work is urgent: only what the last scan changed is left as it is. Scans at
/// 6.5 cm hardly come here; one scan at 1 cm changes nearly as many.
const MOST_RESIDENT: usize = 1 << 17;
/// Number of bricks that are encoded before their slots are freed.
const BATCH: usize = 8192;
/// Number of bricks that one task encodes.
const BRICKS_PER_TASK: usize = 256;
/// Typical length of an encoded brick, words.
const TYPICAL_WORDS: usize = 24;
/// How many blocks or bricks ahead one is prefetched.
const AHEAD: usize = 4;

/// Pages of bricks, released by one field and adopted by another.
pub(crate) type BrickPages = Vec<PageVec<Brick>>;

impl TsdfField {
    /// Records that a scan has changed blocks `ids`, and compresses the blocks that none of the last scans changed.
    pub(crate) fn record_changes(&mut self, ids: Vec<u32>) {
        self.change_log.clock = self.change_log.clock.wrapping_add(1);
        let clock = self.change_log.clock;
        ids.iter().for_each(|&id| self.blocks[id].changed = clock);
        self.change_log.changes.push_back((clock, ids));
        let mut left = MAX_BLOCKS_PER_SCAN;
        loop {
            let is_urgent = self.bricks.live() > MOST_RESIDENT || is_tight();
            let (recent, limit) = if is_urgent { (1, MAX_BLOCKS_PER_SCAN) } else { (RECENT_CHANGES, left) };
            if self.change_log.changes.len() <= recent || limit == 0 {
                return;
            }
            left = left.saturating_sub(self.compress_oldest(limit));
        }
    }

    /// Compresses at most `limit` blocks of the oldest scan in the change log that no later one changed, and returns how many.
    fn compress_oldest(&mut self, limit: usize) -> usize {
        let Some((clock, mut ids)) = self.change_log.changes.pop_front() else { return 0 };
        ids.retain(|&id| self.blocks[id].changed == clock);
        if ids.len() > limit {
            self.change_log.changes.push_front((clock, ids.split_off(limit)));
        }
        let mut resident = Vec::with_capacity(4 * ids.len());
        for (i, &id) in ids.iter().enumerate() {
            ids.get(i + AHEAD).into_iter().for_each(|&next| prefetch_item(&raw const self.blocks[next]));
            let block = &self.blocks[id];
            let bricks = block.bricks.iter().enumerate().filter_map(|(k, brick)| Some((k, brick.slot()?)));
            resident.extend(bricks.map(|(k, slot)| ResidentBrick { owner: owner(id, k), slot, has_intensity: block.brick_has_intensity(k) }));
        }
        self.compress_bricks(&resident);
        ids.len()
    }

    /// Compresses at most `limit` bricks, beginning with the last in memory, and moves the pages that become empty to `pages`. Returns the
    /// number of bricks compressed.
    pub(crate) fn compact_from_end(&mut self, limit: usize, pages: &mut BrickPages) -> usize {
        let owners = (0..self.bricks.capacity_used()).rev().filter_map(|slot| Some((slot, self.bricks.owner(slot)?)));
        let resident: Vec<ResidentBrick> =
            owners.take(limit).map(|(slot, owner)| ResidentBrick { owner, slot, has_intensity: self.owner_has_intensity(owner) }).collect();
        self.compress_bricks(&resident);
        self.bricks.release_pages(pages);
        if self.is_compact() {
            self.change_log.changes = VecDeque::new();
        }
        resident.len()
    }

    /// Number of bricks that are not compressed.
    pub(crate) fn resident_bricks(&self) -> usize {
        self.bricks.live()
    }

    /// Whether all bricks are compressed.
    pub(crate) fn is_compact(&self) -> bool {
        self.resident_bricks() == 0
    }

    /// Takes over pages that another field released, as many as the next scans may need.
    pub(crate) fn adopt_pages(&mut self, pages: BrickPages) {
        /// About the number of bricks that two or three scans of an unmapped place create.
        const SPARE: usize = 16384;
        self.bricks.adopt_pages(pages, SPARE);
    }

    /// Compresses all bricks.
    pub(crate) fn compact_all(&mut self) {
        self.change_log.changes.clear();
        while self.compact_from_end(BATCH, &mut Vec::new()) > 0 {}
    }

    fn owner_has_intensity(&self, owner: u32) -> bool {
        let (id, brick) = block_and_brick(owner);
        self.blocks[id].brick_has_intensity(brick)
    }

    fn compress_bricks(&mut self, resident: &[ResidentBrick]) {
        for batch in resident.chunks(BATCH) {
            let tasks: Vec<EncodedBricks> = batch
                .par_chunks(BRICKS_PER_TASK)
                .map(|resident| {
                    let mut encoded = EncodedBricks::default();
                    dispatch(EncodeBricks { bricks: &self.bricks, resident, encoded: &mut encoded });
                    encoded
                })
                .collect();
            for (resident, encoded) in batch.chunks(BRICKS_PER_TASK).zip(tasks) {
                let mut words = &encoded.words[..];
                for (source, &length) in resident.iter().zip(&encoded.lengths) {
                    let (id, brick) = block_and_brick(source.owner);
                    let (own, others) = words.split_at(length.into());
                    words = others;
                    self.blocks[id].bricks[brick] =
                        if own.is_empty() { BrickHandle::ABSENT } else { BrickHandle::compressed(self.compressed.insert(source.owner, own)) };
                    self.bricks.remove(source.slot);
                }
            }
        }
    }
}

/// A brick to be compressed.
#[derive(Clone, Copy)]
struct ResidentBrick {
    owner: u32,
    slot: u32,
    has_intensity: bool,
}

/// Encoded bricks, end to end.
#[derive(Default)]
struct EncodedBricks {
    words: Vec<u32>,
    /// Number of words of each brick; 0 for a brick of zeros.
    lengths: Vec<u8>,
}

/// Encodes resident bricks.
struct EncodeBricks<'a> {
    bricks: &'a Slab<Brick>,
    resident: &'a [ResidentBrick],
    encoded: &'a mut EncodedBricks,
}

impl Kernel for EncodeBricks<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { bricks, resident, encoded } = self;
        encoded.words.reserve(resident.len() * TYPICAL_WORDS);
        encoded.lengths.reserve(resident.len());
        let mut buffer = EncodedBrick::EMPTY;
        for (i, brick) in resident.iter().enumerate() {
            if let Some(later) = resident.get(i + AHEAD) {
                prefetch_item(&raw const bricks[later.slot]);
            }
            buffer.encode(&bricks[brick.slot], brick.has_intensity);
            let words = if buffer.is_empty() { &[] } else { buffer.words() };
            encoded.words.extend_from_slice(words);
            encoded.lengths.push(words.len() as u8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::voxel::Voxel;
    use std::ops::Range;

    /// Sets one voxel in four bricks of each of `blocks`, as a scan would.
    fn change(field: &mut TsdfField, blocks: Range<u32>, weight: u16) {
        let ids: Vec<u32> = blocks.collect();
        field.write_blocks(&ids, 64, |range, writer| {
            for (i, &id) in ids[range].iter().enumerate() {
                for brick in 0..4 {
                    let cells = writer.brick(i, brick).cells().expect("a resident brick");
                    cells.voxels[id as usize % 64].set(Voxel { distance: id as i16, weight });
                }
            }
        });
        field.record_changes(ids);
    }

    #[test]
    fn scans_that_change_much_leave_few_bricks_uncompressed() {
        const SCANS: u32 = 12;
        // Half of the blocks of a scan are those of the scan before.
        const BLOCKS: u32 = 16_000;
        let mut field = TsdfField::of_empty_blocks(u64::from(BLOCKS / 2 * (SCANS + 1)));
        for scan in 0..SCANS {
            let blocks = scan * BLOCKS / 2..(scan + 2) * BLOCKS / 2;
            change(&mut field, blocks.clone(), scan as u16 + 1);
            assert!(field.resident_bricks() <= MOST_RESIDENT, "{} bricks after scan {scan}", field.resident_bricks());
            let is_resident = |id| field.blocks[id].bricks[..4].iter().all(|brick| brick.slot().is_some());
            assert!(blocks.into_iter().all(is_resident), "what the last scan changed stays");
            field.assert_invariants();
        }
        for id in field.ids() {
            let last = (id / (BLOCKS / 2)).min(SCANS - 1) as u16 + 1;
            let array = field.current(field.block(id));
            let observed: Vec<Voxel> = array.into_iter().filter(|voxel| voxel.is_observed()).collect();
            assert_eq!(observed, [Voxel { distance: id as i16, weight: last }; 4], "block {id}");
        }
    }

    #[test]
    fn scans_that_change_little_keep_eight_scans_uncompressed() {
        let mut field = TsdfField::of_empty_blocks(2000);
        for scan in 0..20 {
            change(&mut field, scan * 100..(scan + 1) * 100, 1);
            assert_eq!(field.resident_bricks(), 400 * (scan as usize + 1).min(RECENT_CHANGES));
        }
    }
}
