//! The TSDF's image: its blocks in Morton order, each with the arrays that it holds. The octree follows from the keys.

use super::ImageError;
use crate::field::tsdf::packed::PackedArray;
use crate::field::tsdf::{Array, Tint, TsdfField, Voxel};
use crate::geometry::morton::AXIS_BITS;
use crate::octree::{Cursor, NONE, SCALES, voxels_at};
use std::ops::RangeInclusive;

/// What there is to know about a block besides its voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockHead {
    /// Morton key of its place.
    pub key: u64,
    /// Scale at which it is integrated, 0 to 3.
    pub scale: u8,
    /// The finest scale for which it holds an array, at most `scale`.
    pub finest: u8,
    /// Whether its voxels have intensities.
    pub shaded: bool,
}

impl BlockHead {
    fn data_scales(&self) -> RangeInclusive<usize> {
        usize::from(self.finest)..=usize::from(self.scale)
    }

    fn past_scales(&self) -> RangeInclusive<usize> {
        usize::from(self.finest) + 1..=usize::from(self.scale)
    }

    /// Voxels in all arrays of the block: those that it is made of, finest first, then what they held before.
    pub fn voxel_count(&self) -> usize {
        self.data_scales().chain(self.past_scales()).map(voxels_at).sum()
    }

    /// Intensities in all arrays of the block, finest first.
    pub fn shade_count(&self) -> usize {
        if self.shaded { self.data_scales().map(voxels_at).sum() } else { 0 }
    }

    /// Refuses what no field can hold.
    ///
    /// # Errors
    /// [`ImageError::Key`] and [`ImageError::Scale`].
    pub fn check(&self) -> Result<(), ImageError> {
        if self.key >> (3 * AXIS_BITS) != 0 {
            return Err(ImageError::Key { key: self.key });
        }
        if usize::from(self.scale) >= SCALES || self.finest > self.scale {
            return Err(ImageError::Scale { key: self.key, scale: self.scale, finest: self.finest });
        }
        Ok(())
    }
}

impl TsdfField {
    /// Ids of all blocks in ascending order of their Morton keys.
    pub fn ids_in_morton_order(&self) -> Vec<u32> {
        let mut ids = Vec::with_capacity(self.len());
        self.tree.for_each(|_, level, octant| {
            if level == 0 && octant.link != NONE {
                ids.push(octant.link);
            }
        });
        ids
    }

    /// The head of block `id`.
    pub fn head(&self, id: u32) -> BlockHead {
        let block = self.block(id);
        BlockHead { key: block.key, scale: block.scale, finest: block.finest, shaded: block.shaded }
    }

    /// All arrays of block `id`, in the order that [`BlockHead::voxel_count`] counts them.
    pub fn stored_voxels(&self, id: u32) -> impl Iterator<Item = Vec<Voxel>> {
        let (head, block) = (self.head(id), self.block(id));
        let arrays = head.data_scales().map(Array::Data).chain(head.past_scales().map(Array::Past));
        arrays.map(|array| self.voxels(block, array))
    }

    /// All intensity arrays of block `id`, in the order that [`BlockHead::shade_count`] counts them.
    pub fn stored_shades(&self, id: u32) -> impl Iterator<Item = Vec<u8>> {
        let (head, block) = (self.head(id), self.block(id));
        head.data_scales().filter(move |_| head.shaded).map(|s| self.shades(block, s))
    }

    /// Gives the block with `key` its colours at `scale`: what [`colours`](Self::colours) told of it.
    ///
    /// # Errors
    /// [`ImageError::NoBlock`], [`ImageError::Scale`] and [`ImageError::Length`].
    pub fn set_colours(&mut self, key: u64, scale: u8, tints: &[Tint]) -> Result<(), ImageError> {
        if usize::from(scale) >= SCALES {
            return Err(ImageError::Scale { key, scale, finest: scale });
        }
        let expected = voxels_at(scale.into());
        if tints.len() != expected {
            return Err(ImageError::Length { key, of: "colours", got: tints.len(), expected });
        }
        let id = self.find(key).ok_or(ImageError::NoBlock { key })?;
        self.colours.replace(id, scale.into()).copy_from_slice(tints);
        Ok(())
    }
}

/// Rebuilds a field from its image, block by block in Morton order.
#[derive(Debug)]
pub struct TsdfBuilder {
    field: TsdfField,
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
    /// Adds the next block: its `voxels` and `shades` are all arrays of [`TsdfField::stored_voxels`] and
    /// [`TsdfField::stored_shades`] end to end.
    ///
    /// # Errors
    /// When the head is impossible, when keys do not ascend, and when the arrays do not have the head's lengths.
    pub fn push(&mut self, head: BlockHead, voxels: &[Voxel], shades: &[u8]) -> Result<(), ImageError> {
        head.check()?;
        let key = head.key;
        if let Some(last) = self.last.filter(|&last| last >= key) {
            return Err(ImageError::Order { key, last });
        }
        for (of, got, expected) in [("voxels", voxels.len(), head.voxel_count()), ("intensities", shades.len(), head.shade_count())] {
            if got != expected {
                return Err(ImageError::Length { key, of, got, expected });
            }
        }
        self.last = Some(key);
        let field = &mut self.field;
        if !field.tree.covers(key) {
            field.tree.grow_to(key);
            self.cursor = Cursor::new(&field.tree);
        }
        let (id, _) = field.make(&mut self.cursor, key, head.scale, head.shaded);
        field.blocks[id].finest = head.finest;
        self.fill(id, &head, voxels, shades);
        Ok(())
    }

    fn fill(&mut self, id: u32, head: &BlockHead, mut voxels: &[Voxel], mut shades: &[u8]) {
        for scale in head.data_scales() {
            let array = voxels.split_off(..voxels_at(scale)).unwrap_or_default();
            let shades = head.shaded.then(|| shades.split_off(..voxels_at(scale)).unwrap_or_default());
            self.field.store(id, Array::Data(scale), &PackedArray::new(scale, array, shades));
        }
        for scale in head.past_scales() {
            let array = voxels.split_off(..voxels_at(scale)).unwrap_or_default();
            self.field.store(id, Array::Past(scale), &PackedArray::new(scale, array, None));
        }
    }

    /// The field.
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
            let sorted: BTreeMap<u64, BlockHead> =
                heads.into_iter().map(|(key, a, b, shaded)| (key, BlockHead { key, scale: a.max(b), finest: a.min(b), shaded })).collect();
            sorted.into_values().collect()
        })
    }

    proptest! {
        #[test]
        fn a_rebuilt_field_has_the_same_image(heads in heads(), seed in any::<u16>()) {
            let mut builder = TsdfBuilder::default();
            let mut number = seed;
            let mut next = || { number = number.wrapping_mul(25_173).wrapping_add(13_849); number };
            let mut images = Vec::new();
            for &head in &heads {
                let voxels: Vec<Voxel> = (0..head.voxel_count()).map(|_| Voxel { distance: next() as i16, weight: next() }).collect();
                let shades: Vec<u8> = (0..head.shade_count()).map(|_| (next() >> 8) as u8).collect();
                builder.push(head, &voxels, &shades).unwrap();
                images.push((head, voxels, shades));
            }
            let field = builder.finish();
            let ids = field.ids_in_morton_order();
            prop_assert_eq!(ids.len(), images.len());
            for (id, (head, voxels, shades)) in ids.into_iter().zip(images) {
                prop_assert_eq!(field.head(id), head);
                prop_assert_eq!(field.find(head.key), Some(id));
                prop_assert_eq!(field.stored_voxels(id).collect::<Vec<_>>().concat(), voxels);
                prop_assert_eq!(field.stored_shades(id).collect::<Vec<_>>().concat(), shades);
            }
        }
    }

    #[test]
    fn what_is_no_image_is_refused() {
        let head = BlockHead { key: 7, scale: 3, finest: 3, shaded: false };
        let mut builder = TsdfBuilder::default();
        let one = [Voxel::default()];
        assert_eq!(builder.push(BlockHead { key: 1 << 63, ..head }, &one, &[]), Err(ImageError::Key { key: 1 << 63 }));
        assert_eq!(builder.push(BlockHead { finest: 4, scale: 4, ..head }, &one, &[]), Err(ImageError::Scale { key: 7, scale: 4, finest: 4 }));
        assert_eq!(builder.push(BlockHead { scale: 2, ..head }, &one, &[]), Err(ImageError::Scale { key: 7, scale: 2, finest: 3 }));
        assert_eq!(builder.push(head, &[], &[]), Err(ImageError::Length { key: 7, of: "voxels", got: 0, expected: 1 }));
        assert_eq!(builder.push(head, &one, &[1]), Err(ImageError::Length { key: 7, of: "intensities", got: 1, expected: 0 }));
        assert_eq!(builder.push(head, &one, &[]), Ok(()));
        assert_eq!(builder.push(head, &one, &[]), Err(ImageError::Order { key: 7, last: 7 }));
        assert_eq!(builder.finish().len(), 1);
    }
}
