//! Removal of voxels from a field.

use super::block::Array;
use super::field::TsdfField;
use super::voxel::{DISTANCE_STEPS, Voxel};
use crate::octree::{BLOCK_EDGE, SCALES, block_coords, voxel_coords, voxels_at};
use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};

/// Which blocks voxels are removed from.
#[derive(Clone, Copy, Debug)]
pub(crate) enum RemoveFrom<'a> {
    /// Those with these keys.
    Blocks(&'a HashSet<u64>),
    /// Those in which a voxel next to the surface goes; of such voxels, some are asked.
    BlocksWithSurface,
}

impl TsdfField {
    /// Removes the observed voxels whose centres, finest voxels, are to be removed, in all arrays of the blocks `from` names; returns how many they are.
    pub(crate) fn remove_voxels(&mut self, from: RemoveFrom<'_>, is_removed: &(impl Fn(&[[f32; 3]]) -> Vec<bool> + Sync)) -> usize {
        let mut ids = self.ids_in_morton_order();
        if let RemoveFrom::Blocks(keys) = from {
            ids.retain(|id| keys.contains(&self.blocks[*id].key));
        }
        let mut changed = vec![false; ids.len()];
        let mut removed = 0;
        // One array after the other: a block may decompress no more bricks at a time than one array has.
        for array in (0..SCALES).map(Array::Data).chain((1..SCALES).map(Array::Base)) {
            for (position, count) in self.remove_from_array(&ids, array, from, is_removed) {
                changed[position] = true;
                removed += count;
            }
        }
        let changed = ids.into_iter().zip(changed).filter(|(_, changed)| *changed).map(|(id, _)| id).collect();
        self.record_changes(changed);
        removed
    }

    /// As [`remove_voxels`](Self::remove_voxels), of one array of each block that has it; returns the positions of the changed blocks in `ids`, with the number of
    /// voxels removed.
    fn remove_from_array(
        &mut self,
        ids: &[u32],
        array: Array,
        from: RemoveFrom<'_>,
        is_removed: &(impl Fn(&[[f32; 3]]) -> Vec<bool> + Sync),
    ) -> Vec<(usize, usize)> {
        /// Blocks of one task.
        const BLOCKS_PER_TASK: usize = 32;
        /// Voxels.
        const NEXT_TO_SURFACE: f32 = 0.75;
        /// One of so many voxels next to the surface is asked first.
        const PROBE: usize = 3;
        let (scale, is_base) = (array.scale(), matches!(array, Array::Base(_)));
        let all = Mutex::new(Vec::new());
        self.write_blocks(ids, BLOCKS_PER_TASK, |range, writer| {
            let (mut buffer, mut intensities) = ([Voxel::default(); voxels_at(0)], [0u8; voxels_at(0)]);
            let (voxels, intensities) = (&mut buffer[..voxels_at(scale)], &mut intensities[..voxels_at(scale)]);
            for (i, position) in range.enumerate() {
                let block = writer.block(i);
                let (key, has_intensity) = (block.key, block.has_intensity && !is_base);
                if !(usize::from(block.finest) + usize::from(is_base)..=usize::from(block.scale)).contains(&scale) {
                    continue;
                }
                writer.copy(i, array, voxels);
                let gone_of = |observed: Vec<usize>| -> Vec<usize> {
                    let centres: Vec<[f32; 3]> = observed.iter().map(|&v| centre(key, v, scale)).collect();
                    observed.into_iter().zip(is_removed(&centres)).filter(|(_, gone)| *gone).map(|(v, _)| v).collect()
                };
                // Where none of the voxels next to the surface goes, none does; some of them tell.
                let next_to_surface = |voxel: &Voxel| voxel.is_observed() && f32::from(voxel.distance).abs() <= NEXT_TO_SURFACE * DISTANCE_STEPS;
                let some = || (0..voxels.len()).filter(|&v| next_to_surface(&voxels[v])).step_by(PROBE).collect();
                if matches!(from, RemoveFrom::BlocksWithSurface) && gone_of(some()).is_empty() {
                    continue;
                }
                let gone = gone_of((0..voxels.len()).filter(|&v| voxels[v].is_observed()).collect());
                if gone.is_empty() {
                    continue;
                }
                intensities.fill(0);
                if has_intensity {
                    writer.copy_intensities(i, scale, intensities);
                }
                gone.iter().for_each(|&v| (voxels[v], intensities[v]) = (Voxel::default(), 0));
                writer.store(i, array, voxels, intensities);
                all.lock().unwrap_or_else(PoisonError::into_inner).push((position, gone.len()));
            }
        });
        all.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Centre of voxel `v` of a block's array at `scale`, finest voxels.
fn centre(key: u64, v: usize, scale: usize) -> [f32; 3] {
    let (coords, c) = (block_coords(key), voxel_coords(v, scale));
    std::array::from_fn(|k| (coords[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * (1 << scale) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{BlockHead, TsdfBuilder};

    #[test]
    fn removed_voxels_are_unobserved_and_the_others_stay() {
        let mut builder = TsdfBuilder::default();
        let head = BlockHead { key: crate::octree::block_key([1, -2, 0]), scale: 0, finest: 0, has_intensity: true };
        let voxels: Vec<Voxel> = (0..voxels_at(0)).map(|i| Voxel { distance: i as i16, weight: 16 }).collect();
        let intensities: Vec<u8> = (0..voxels_at(0)).map(|i| (1 + i % 200) as u8).collect();
        builder.push(head, &[voxels.clone()].concat(), &[intensities.clone()].concat()).unwrap();
        let mut field = builder.finish();
        // The half of the block with x below 12.
        let removed = field.remove_voxels(RemoveFrom::BlocksWithSurface, &|centres: &[[f32; 3]]| centres.iter().map(|c| c[0] < 12.0).collect());
        assert_eq!(removed, voxels_at(0) / 2);
        field.compact_all();
        let now = field.current(field.block(0));
        for (i, voxel) in now.iter().enumerate() {
            let expected = if voxel_coords(i, 0)[0] < 4 { Voxel::default() } else { voxels[i] };
            assert_eq!(*voxel, expected, "{i}");
        }
        let stored = field.stored_intensities(0);
        assert!(stored.iter().enumerate().all(|(i, v)| *v == if voxel_coords(i, 0)[0] < 4 { 0 } else { intensities[i] }));
    }

    #[test]
    fn blocks_that_are_named_need_no_surface() {
        let mut builder = TsdfBuilder::default();
        let head = BlockHead { key: crate::octree::block_key([0, 0, 0]), scale: 0, finest: 0, has_intensity: false };
        let far = Voxel { distance: DISTANCE_STEPS as i16, weight: 16 };
        builder.push(head, &vec![far; voxels_at(0)], &[]).unwrap();
        let mut field = builder.finish();
        let all = |centres: &[[f32; 3]]| vec![true; centres.len()];
        assert_eq!(field.remove_voxels(RemoveFrom::BlocksWithSurface, &all), 0);
        assert_eq!(field.remove_voxels(RemoveFrom::Blocks(&HashSet::from([head.key + 1])), &all), 0);
        assert_eq!(field.remove_voxels(RemoveFrom::Blocks(&HashSet::from([head.key])), &all), voxels_at(0));
    }
}
