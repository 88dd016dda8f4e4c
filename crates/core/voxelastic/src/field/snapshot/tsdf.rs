//! The snapshot of a TSDF: its blocks in Morton order, each with all its arrays. The octree follows from the keys.

use super::SnapshotError;
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{Array, ColourVoxel, TsdfField, Voxel};
use crate::geometry::morton::AXIS_BITS;
use crate::octree::{Cursor, SCALES, voxels_at};
use std::ops::RangeInclusive;

/// A block without its voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockHead {
    /// Morton key of its position, see [`block_key`](crate::octree::block_key).
    pub key: u64,
    /// Its current scale, 0 to 3.
    pub scale: u8,
    /// The finest scale at which it has an array, at most `scale`.
    pub finest: u8,
    /// Whether its voxels have intensities.
    pub has_intensity: bool,
}

impl BlockHead {
    pub(super) fn data_scales(&self) -> RangeInclusive<usize> {
        usize::from(self.finest)..=usize::from(self.scale)
    }

    pub(super) fn base_scales(&self) -> RangeInclusive<usize> {
        usize::from(self.finest) + 1..=usize::from(self.scale)
    }

    /// Number of voxels in all arrays of the block: its data arrays, finest first, then the base arrays, which hold the values that each
    /// coarser scale started from.
    pub fn voxel_count(&self) -> usize {
        self.data_scales().chain(self.base_scales()).map(voxels_at).sum()
    }

    /// Number of intensities in all data arrays of the block, finest first.
    pub fn intensity_count(&self) -> usize {
        if self.has_intensity { self.data_scales().map(voxels_at).sum() } else { 0 }
    }

    /// Checks that key and scales are in range.
    ///
    /// # Errors
    /// [`SnapshotError::Key`] or [`SnapshotError::Scale`] if not.
    pub fn check(&self) -> Result<(), SnapshotError> {
        if self.key >> (3 * AXIS_BITS) != 0 {
            return Err(SnapshotError::Key { key: self.key });
        }
        if usize::from(self.scale) >= SCALES || self.finest > self.scale {
            return Err(SnapshotError::Scale { key: self.key, scale: self.scale, finest: self.finest });
        }
        Ok(())
    }
}

impl TsdfField {
    /// Ids of all blocks in ascending order of their Morton keys.
    pub fn ids_in_morton_order(&self) -> Vec<u32> {
        self.tree.block_ids()
    }

    /// The head of block `id`.
    pub fn head(&self, id: u32) -> BlockHead {
        let block = self.block(id);
        BlockHead { key: block.key, scale: block.scale, finest: block.finest, has_intensity: block.has_intensity }
    }

    /// All arrays of block `id`, end to end, in the order of [`BlockHead::voxel_count`].
    pub fn stored_voxels(&self, id: u32) -> Vec<Voxel> {
        let (head, block) = (self.head(id), self.block(id));
        let arrays = head.data_scales().map(Array::Data).chain(head.base_scales().map(Array::Base));
        arrays.flat_map(|array| self.voxels(block, array)).collect()
    }

    /// All intensity arrays of block `id`, end to end, in the order of [`BlockHead::intensity_count`].
    pub fn stored_intensities(&self, id: u32) -> Vec<u8> {
        let (head, block) = (self.head(id), self.block(id));
        head.data_scales().filter(|_| head.has_intensity).flat_map(|scale| self.intensities(block, scale)).collect()
    }

    /// Sets the colours of the block with `key` at `scale`, as [`ColourLayer::block`](crate::field::tsdf::ColourLayer::block) returns them.
    ///
    /// # Errors
    /// [`SnapshotError::NoBlock`] if there is no such block; [`SnapshotError::Scale`] and [`SnapshotError::Length`] if scale or length is
    /// wrong.
    pub fn set_colours(&mut self, key: u64, scale: u8, colours: &[ColourVoxel]) -> Result<(), SnapshotError> {
        if usize::from(scale) >= SCALES {
            return Err(SnapshotError::Scale { key, scale, finest: scale });
        }
        let expected = voxels_at(scale.into());
        if colours.len() != expected {
            return Err(SnapshotError::Length { key, of: "colours", got: colours.len(), expected });
        }
        let id = self.find(key).ok_or(SnapshotError::NoBlock { key })?;
        self.colours.replace(id, scale.into()).copy_from_slice(colours);
        Ok(())
    }
}

/// Rebuilds a TSDF from its snapshot, block by block in Morton order.
#[derive(Debug)]
pub struct TsdfBuilder {
    pub(super) field: TsdfField,
    cursor: Cursor,
    last: Option<u64>,
}

impl Default for TsdfBuilder {
    fn default() -> Self {
        let field = TsdfField::default();
        Self { cursor: Cursor::new(&field.tree), field, last: None }
    }
}

impl TsdfBuilder {
    /// Adds the next block: its `voxels` and `intensities` are [`TsdfField::stored_voxels`] and [`TsdfField::stored_intensities`].
    ///
    /// # Errors
    /// If the head is invalid, if keys do not ascend, and if `voxels` or `intensities` does not have the length that the head requires.
    pub fn push(&mut self, head: BlockHead, voxels: &[Voxel], intensities: &[u8]) -> Result<(), SnapshotError> {
        head.check()?;
        for (of, got, expected) in [("voxels", voxels.len(), head.voxel_count()), ("intensities", intensities.len(), head.intensity_count())] {
            if got != expected {
                return Err(SnapshotError::Length { key: head.key, of, got, expected });
            }
        }
        let id = self.begin(head)?;
        self.fill(id, &head, voxels, intensities);
        Ok(())
    }

    /// Makes the next block, without arrays, and returns its id.
    pub(super) fn begin(&mut self, head: BlockHead) -> Result<u32, SnapshotError> {
        let key = head.key;
        if let Some(last) = self.last.filter(|&last| last >= key) {
            return Err(SnapshotError::Order { key, last });
        }
        self.last = Some(key);
        let field = &mut self.field;
        if !field.tree.covers(key) {
            field.tree.grow_to(key);
            self.cursor = Cursor::new(&field.tree);
        }
        let (id, _) = field.find_or_create(&mut self.cursor, key, head.scale, head.has_intensity);
        field.blocks[id].finest = head.finest;
        Ok(id)
    }

    fn fill(&mut self, id: u32, head: &BlockHead, mut voxels: &[Voxel], mut intensities: &[u8]) {
        for scale in head.data_scales() {
            let array = voxels.split_off(..voxels_at(scale)).unwrap_or_default();
            let intensities = head.has_intensity.then(|| intensities.split_off(..voxels_at(scale)).unwrap_or_default());
            self.field.store(id, Array::Data(scale), &EncodedArray::new(scale, array, intensities));
        }
        for scale in head.base_scales() {
            let array = voxels.split_off(..voxels_at(scale)).unwrap_or_default();
            self.field.store(id, Array::Base(scale), &EncodedArray::new(scale, array, None));
        }
    }

    /// Returns the field.
    pub fn finish(self) -> TsdfField {
        self.field
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn heads() -> impl Strategy<Value = Vec<BlockHead>> {
        let near = 0u64..5000;
        let any_key = 0u64..1 << 63;
        let head = (prop_oneof![3 => near, 1 => any_key], 0u8..4, 0u8..4, any::<bool>());
        prop::collection::vec(head, 0..60).prop_map(|heads| {
            let sorted: BTreeMap<u64, BlockHead> = heads
                .into_iter()
                .map(|(key, a, b, has_intensity)| (key, BlockHead { key, scale: a.max(b), finest: a.min(b), has_intensity }))
                .collect();
            sorted.into_values().collect()
        })
    }

    proptest! {
        #[test]
        fn a_rebuilt_field_has_the_same_snapshot(heads in heads(), seed in any::<u16>()) {
            let mut builder = TsdfBuilder::default();
            let mut number = seed;
            let mut next = || { number = number.wrapping_mul(25_173).wrapping_add(13_849); number };
            let mut expected = Vec::new();
            for &head in &heads {
                let voxels: Vec<Voxel> = (0..head.voxel_count()).map(|_| Voxel { distance: next() as i16, weight: next() }).collect();
                let intensities: Vec<u8> = (0..head.intensity_count()).map(|_| (next() >> 8) as u8).collect();
                builder.push(head, &voxels, &intensities).unwrap();
                expected.push((head, voxels, intensities));
            }
            let field = builder.finish();
            let ids = field.ids_in_morton_order();
            prop_assert_eq!(ids.len(), expected.len());
            for (id, (head, voxels, intensities)) in ids.into_iter().zip(expected) {
                prop_assert_eq!(field.head(id), head);
                prop_assert_eq!(field.find(head.key), Some(id));
                prop_assert_eq!(field.stored_voxels(id), voxels);
                prop_assert_eq!(field.stored_intensities(id), intensities);
            }
        }
    }

    #[test]
    fn invalid_snapshots_are_rejected() {
        let head = BlockHead { key: 7, scale: 3, finest: 3, has_intensity: false };
        let mut builder = TsdfBuilder::default();
        let one = [Voxel::default()];
        assert_eq!(builder.push(BlockHead { key: 1 << 63, ..head }, &one, &[]), Err(SnapshotError::Key { key: 1 << 63 }));
        assert_eq!(builder.push(BlockHead { finest: 4, scale: 4, ..head }, &one, &[]), Err(SnapshotError::Scale { key: 7, scale: 4, finest: 4 }));
        assert_eq!(builder.push(BlockHead { scale: 2, ..head }, &one, &[]), Err(SnapshotError::Scale { key: 7, scale: 2, finest: 3 }));
        assert_eq!(builder.push(head, &[], &[]), Err(SnapshotError::Length { key: 7, of: "voxels", got: 0, expected: 1 }));
        assert_eq!(builder.push(head, &one, &[1]), Err(SnapshotError::Length { key: 7, of: "intensities", got: 1, expected: 0 }));
        assert_eq!(builder.push(head, &one, &[]), Ok(()));
        assert_eq!(builder.push(head, &one, &[]), Err(SnapshotError::Order { key: 7, last: 7 }));
        assert_eq!(builder.finish().len(), 1);
    }
}
