//! Blocks of a TSDF without the voxels that are zero, brick by brick. Fields store bricks in this way, too, so neither packing nor unpacking goes
//! through whole arrays, of which three voxels of four are zero.

use super::SnapshotError;
use super::tsdf::{BlockHead, TsdfBuilder};
use crate::field::tsdf::brick::{BRICK, Brick, BrickHandle, BrickState};
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{Array, TsdfField, Voxel};
use crate::octree::{prefetch_item, voxels_at};
use bytemuck::Zeroable;

/// How many blocks ahead the bricks of one are prefetched; its head is twice as early.
const AHEAD: usize = 8;

/// Blocks with all their arrays, without zeros. A brick is 4 x 4 x 4 voxels of an array, x fastest; eight make an array at scale 0, x fastest, and the arrays at
/// other scales have one. Masks are a bit per voxel of a brick, lowest first, set where the value is not zero.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PackedBlocks {
    /// The blocks, in Morton order.
    pub heads: Vec<BlockHead>,
    /// The mask of each brick: those of [`BlockHead::brick_scales`] of each block.
    pub masks: Vec<u64>,
    /// The voxels in the masks.
    pub voxels: Vec<Voxel>,
    /// The mask of the intensities of each brick that has any: those of [`BlockHead::intensity_brick_scales`] of each block.
    pub intensity_masks: Vec<u64>,
    /// The intensities in these masks.
    pub intensities: Vec<u8>,
}

/// The mask of all voxels of a brick of an array at `scale`.
pub fn full_mask(scale: usize) -> u64 {
    u64::MAX >> (BRICK - voxels_at(scale).min(BRICK))
}

impl BlockHead {
    /// The scale of each brick of the block: those of its data arrays, finest first, then of the base arrays.
    pub fn brick_scales(&self) -> impl Iterator<Item = usize> {
        self.intensity_scales(true).chain(self.base_scales())
    }

    /// The scale of each brick with intensities: those of its data arrays, if they have any.
    pub fn intensity_brick_scales(&self) -> impl Iterator<Item = usize> {
        self.intensity_scales(self.has_intensity)
    }

    fn intensity_scales(&self, has_any: bool) -> impl Iterator<Item = usize> {
        let scales = self.data_scales().filter(move |_| has_any);
        scales.flat_map(|scale| std::iter::repeat_n(scale, Array::Data(scale).bricks().len()))
    }
}

impl TsdfField {
    /// Packs the blocks `ids` into `packed`, in place of what is there.
    pub fn pack(&self, ids: &[u32], packed: &mut PackedBlocks) {
        packed.clear();
        for (i, &id) in ids.iter().enumerate() {
            // Neighbours are far apart in memory.
            ids.get(i + 2 * AHEAD).into_iter().for_each(|&later| prefetch_item(&raw const *self.block(later)));
            ids.get(i + AHEAD).into_iter().for_each(|&next| self.prefetch_stored(next));
            let (head, block) = (self.head(id), self.block(id));
            for array in head.data_scales().map(Array::Data).chain(head.base_scales().map(Array::Base)) {
                let has_intensity = head.has_intensity && matches!(array, Array::Data(_));
                block.bricks[array.bricks()].iter().for_each(|brick| self.pack_brick(*brick, full_mask(array.scale()), has_intensity, packed));
            }
            packed.heads.push(head);
        }
    }

    fn pack_brick(&self, brick: BrickHandle, within: u64, has_intensity: bool, packed: &mut PackedBlocks) {
        let PackedBlocks { masks, voxels, intensity_masks, intensities, .. } = packed;
        let (mask, of_intensities) = match brick.state() {
            BrickState::Absent => (0, 0),
            BrickState::Resident(slot) => {
                let Brick { voxels: all, intensities: all_intensities } = &self.bricks[slot];
                (append_set(all, within, voxels), if has_intensity { append_set(all_intensities, within, intensities) } else { 0 })
            }
            BrickState::Compressed(number) => {
                let view = self.compressed.get(number);
                (view.append_voxels(within, voxels), if has_intensity { view.append_intensities(within, intensities) } else { 0 })
            }
        };
        masks.push(mask);
        if has_intensity {
            intensity_masks.push(of_intensities);
        }
    }
}

/// Appends the values that are not zero; returns their mask.
fn append_set<T: Copy + Default + PartialEq>(values: &[T; BRICK], within: u64, out: &mut Vec<T>) -> u64 {
    let set = values.iter().rev().fold(0, |mask, value| mask << 1 | u64::from(*value != T::default())) & within;
    out.extend(values.iter().enumerate().filter(|(i, _)| set >> i & 1 == 1).map(|(_, value)| *value));
    set
}

impl PackedBlocks {
    /// Removes all blocks, and keeps the memory.
    fn clear(&mut self) {
        let Self { heads, masks, voxels, intensity_masks, intensities } = self;
        heads.clear();
        masks.clear();
        voxels.clear();
        intensity_masks.clear();
        intensities.clear();
    }

    /// Checks that masks and values are as many as the heads require, and that no mask is longer than its brick.
    fn check(&self) -> Result<(), SnapshotError> {
        let (mut masks, mut intensity_masks) = (self.masks.iter(), self.intensity_masks.iter());
        for head in &self.heads {
            let is_longer = |(scale, mask): (usize, &u64)| mask & !full_mask(scale) != 0;
            // In this order: `zip` takes a mask only where there is a brick for it.
            if head.brick_scales().zip(&mut masks).any(is_longer) || head.intensity_brick_scales().zip(&mut intensity_masks).any(is_longer) {
                return Err(SnapshotError::Mask { key: head.key });
            }
        }
        let key = self.heads.first().map_or(0, |head| head.key);
        let ones = |masks: &[u64]| masks.iter().map(|mask| mask.count_ones() as usize).sum();
        for (of, got, expected) in [
            ("masks", self.masks.len(), self.heads.iter().flat_map(BlockHead::brick_scales).count()),
            ("voxels", self.voxels.len(), ones(&self.masks)),
            ("masks of intensities", self.intensity_masks.len(), self.heads.iter().flat_map(BlockHead::intensity_brick_scales).count()),
            ("intensities", self.intensities.len(), ones(&self.intensity_masks)),
        ] {
            if got != expected {
                return Err(SnapshotError::Length { key, of, got, expected });
            }
        }
        Ok(())
    }
}

/// Takes the values of a mask from the beginning of `values` and puts them in their places.
fn take_set<T: Copy + Default>(mask: u64, values: &mut &[T]) -> [T; BRICK] {
    let mut brick = [T::default(); BRICK];
    let mut left = mask;
    for &value in values.split_off(..mask.count_ones() as usize).unwrap_or_default() {
        brick[left.trailing_zeros() as usize % BRICK] = value;
        left &= left - 1;
    }
    brick
}

impl TsdfBuilder {
    /// Adds the next blocks.
    ///
    /// # Errors
    /// If a head is invalid, if keys do not ascend, if a mask is longer than its brick, and if there are not as many masks and values as the heads require.
    pub fn push_packed(&mut self, blocks: &PackedBlocks) -> Result<(), SnapshotError> {
        blocks.heads.iter().try_for_each(BlockHead::check)?;
        blocks.check()?;
        let (mut masks, mut intensity_masks) = (blocks.masks.iter(), blocks.intensity_masks.iter());
        let (mut voxels, mut intensities) = (&blocks.voxels[..], &blocks.intensities[..]);
        for &head in &blocks.heads {
            let id = self.begin(head)?;
            let data = head.data_scales().map(|scale| (Array::Data(scale), head.has_intensity));
            for (array, has_intensity) in data.chain(head.base_scales().map(|scale| (Array::Base(scale), false))) {
                let bricks = array.bricks().map(|_| {
                    let mut brick = Brick::zeroed();
                    brick.voxels = take_set(masks.next().copied().unwrap_or_default(), &mut voxels);
                    if has_intensity {
                        brick.intensities = take_set(intensity_masks.next().copied().unwrap_or_default(), &mut intensities);
                    }
                    brick
                });
                self.field.store(id, array, &EncodedArray::of_bricks(bricks, has_intensity));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Rigid;
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// A field with blocks at several scales, of which about a third of the voxels and of the intensities are not zero, not always at the same places.
    fn field(heads: &BTreeMap<u64, (u8, u8, bool)>, seed: u64) -> TsdfField {
        let mut state = seed;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32
        };
        let mut builder = TsdfBuilder::default();
        for (&key, &(a, b, has_intensity)) in heads {
            let head = BlockHead { key, scale: a.max(b), finest: a.min(b), has_intensity };
            let voxel =
                |n: u32| if n.is_multiple_of(3) { Voxel { distance: (n >> 8) as i16, weight: (n >> 16) as u16 % 5 } } else { Voxel::default() };
            let voxels: Vec<Voxel> = (0..head.voxel_count()).map(|_| voxel(next())).collect();
            let intensities: Vec<u8> = (0..head.intensity_count()).map(|_| next()).map(|n| if n % 5 < 2 { (n >> 8) as u8 } else { 0 }).collect();
            builder.push(head, &voxels, &intensities).unwrap();
        }
        builder.finish()
    }

    /// Splits arrays into bricks, voxel by voxel: the masks and what is in them.
    fn split<T: Copy + Default + PartialEq>(mut arrays: &[T], scales: impl Iterator<Item = usize>) -> (Vec<u64>, Vec<T>) {
        let (mut masks, mut values) = (Vec::new(), Vec::new());
        for scale in scales {
            let array = arrays.split_off(..voxels_at(scale)).unwrap();
            for brick in 0..voxels_at(scale).div_ceil(64) {
                let index = |i: usize| match scale {
                    0 => (i % 4 + 4 * (brick % 2)) + 8 * (i / 4 % 4 + 4 * (brick / 2 % 2)) + 64 * (i / 16 + 4 * (brick / 4)),
                    _ => i,
                };
                let mut mask = 0;
                for i in 0..voxels_at(scale).min(64) {
                    if array[index(i)] != T::default() {
                        mask |= 1 << i;
                        values.push(array[index(i)]);
                    }
                }
                masks.push(mask);
            }
        }
        assert!(arrays.is_empty());
        (masks, values)
    }

    fn pack_slowly(field: &TsdfField) -> PackedBlocks {
        let mut packed = PackedBlocks::default();
        for id in field.ids_in_morton_order() {
            let head = field.head(id);
            let (masks, voxels) = split(&field.stored_voxels(id), head.data_scales().chain(head.base_scales()));
            let (intensity_masks, intensities) = split(&field.stored_intensities(id), head.data_scales().filter(|_| head.has_intensity));
            packed.heads.push(head);
            packed.masks.extend(masks);
            packed.voxels.extend(voxels);
            packed.intensity_masks.extend(intensity_masks);
            packed.intensities.extend(intensities);
        }
        packed
    }

    fn pack(field: &TsdfField) -> PackedBlocks {
        let mut packed = PackedBlocks::default();
        field.pack(&field.ids_in_morton_order(), &mut packed);
        packed
    }

    fn rebuilt(packed: &PackedBlocks) -> Result<TsdfField, SnapshotError> {
        let mut builder = TsdfBuilder::default();
        builder.push_packed(packed)?;
        Ok(builder.finish())
    }

    proptest! {
        #[test]
        fn packing_equals_packing_voxel_by_voxel_and_comes_back(
            heads in prop::collection::btree_map(0u64..900, (0u8..4, 0u8..4, any::<bool>()), 0..40), seed in any::<u64>(),
        ) {
            let field = field(&heads, seed);
            let packed = pack(&field);
            prop_assert_eq!(&packed, &pack_slowly(&field));
            prop_assert_eq!(pack_slowly(&rebuilt(&packed).unwrap()), packed);
        }
    }

    #[test]
    fn bricks_that_scans_have_just_changed_are_packed_as_well() {
        let points: Vec<[f32; 3]> = (0..80 * 80).map(|i| [(i % 80) as f32 * 0.1 - 4.0, (i / 80) as f32 * 0.1 - 4.0, -2.0]).collect();
        let normals = vec![[0.0, 0.0, 1.0]; points.len()];
        let identity = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };
        let mut field = TsdfField::default();
        let returns = ReturnsView::of_points(&points, &normals, 0.003);
        TsdfIntegrator::new(TsdfSettings { voxel_size: 0.1, ..TsdfSettings::default() }).integrate(&mut field, &identity, &returns);
        assert!(field.resident_bricks() > 100);
        let packed = pack(&field);
        assert!(packed == pack_slowly(&field) && packed.voxels.len() > 1000);
        field.compact_all();
        assert!(field.resident_bricks() == 0 && packed == pack(&field));
    }

    #[test]
    fn what_does_not_fit_its_heads_is_refused() {
        let whole = pack(&field(&[(5, (0, 2, true)), (9, (1, 1, false))].into(), 3));
        assert!(rebuilt(&whole).is_ok());
        let refused = |change: &dyn Fn(&mut PackedBlocks)| {
            let mut packed = whole.clone();
            change(&mut packed);
            rebuilt(&packed).unwrap_err()
        };
        for change in [
            &|p: &mut PackedBlocks| p.masks.truncate(3) as _,
            &|p| p.masks[0] = !p.masks[0] & 1 | p.masks[0] & !1,
            &|p| p.voxels.push(Voxel::default()),
            &|p| _ = p.intensity_masks.pop(),
            &|p| _ = p.intensities.pop(),
        ] as [&dyn Fn(&mut PackedBlocks); 5]
        {
            assert!(matches!(refused(change), SnapshotError::Length { key: 5, .. }));
        }
        // The last array of the first block has eight voxels, as has the last with intensities.
        assert_eq!(refused(&|p| p.masks[11] |= 1 << 9), SnapshotError::Mask { key: 5 });
        assert_eq!(refused(&|p| p.intensity_masks[9] |= 1 << 9), SnapshotError::Mask { key: 5 });
        assert_eq!(refused(&|p| p.heads[1].key = 5), SnapshotError::Order { key: 5, last: 5 });
        assert_eq!(refused(&|p| p.heads[1].finest = 4), SnapshotError::Scale { key: 9, scale: 1, finest: 4 });
    }
}
