//! Some blocks of a field as a field of their own, for those who read them while scans go on to change the whole.

use super::block::{Block, owner};
use super::brick::{Brick, BrickHandle, BrickState};
use super::field::TsdfField;
use super::storage::change_log::ChangeLog;
use crate::octree::{Cursor, Slab};

impl TsdfField {
    /// A copy of blocks `ids`, each once: the first of them has id 0 in it, and so on. Bricks are copied as they are stored. It has the time of the whole.
    pub(crate) fn excerpt(&self, ids: &[u32]) -> Self {
        let mut excerpt = Self { change_log: ChangeLog { clock: self.change_log.clock, ..ChangeLog::default() }, ..Self::default() };
        excerpt.tree.grow_over(ids.iter().map(|id| self.blocks[*id].key));
        let mut cursor = Cursor::new(&excerpt.tree);
        let mut resident: Vec<(u32, &Brick)> = Vec::new();
        for &from in ids {
            let block = self.blocks[from];
            let (id, _) = excerpt.find_or_create(&mut cursor, block.key, block.scale, block.has_intensity);
            let mut bricks = block.bricks;
            for (number, brick) in bricks.iter_mut().enumerate() {
                match brick.state() {
                    BrickState::Absent => {}
                    BrickState::Resident(slot) => {
                        *brick = BrickHandle::resident(resident.len() as u32);
                        resident.push((owner(id, number), &self.bricks[slot]));
                    }
                    BrickState::Compressed(stored) => {
                        *brick = BrickHandle::compressed(excerpt.compressed.insert_copy(owner(id, number), &self.compressed, stored));
                    }
                }
            }
            excerpt.blocks[id] = Block { bricks, ..block };
            if let Some((scale, colours)) = self.colours.block(from) {
                excerpt.colours.replace(id, scale).copy_from_slice(colours);
            }
        }
        excerpt.bricks = Slab::of(resident.into_iter());
        excerpt
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::storage::brick_codec::EncodedArray;
    use crate::field::tsdf::{ColourVoxel, Voxel, WEIGHT_ONE};
    use crate::octree::{block_key, voxels_at};

    #[test]
    fn an_excerpt_has_the_voxels_of_its_blocks_and_no_others() {
        let mut field = TsdfField::default();
        let keys: Vec<u64> = (0..40).map(|x| block_key([3 * x - 50, x % 7, -x])).collect();
        field.tree.grow_over(keys.iter().copied());
        let mut cursor = Cursor::new(&field.tree);
        for (i, key) in keys.iter().enumerate() {
            let (id, _) = field.find_or_create(&mut cursor, *key, 0, false);
            let scale = i % 3;
            let voxels: Vec<Voxel> = (0..voxels_at(scale)).map(|v| Voxel { distance: (v * 7 + i) as i16, weight: WEIGHT_ONE }).collect();
            field.install(id, scale, &EncodedArray::new(scale, &voxels, None));
            if i % 5 == 0 {
                field.colours.replace(id, scale)[0] = ColourVoxel::once([i as u8; 3]);
            }
        }
        // Some bricks are decoded, as a scan leaves them.
        let written: Vec<u32> = (0..40).filter(|id| id % 4 == 1).collect();
        field.write_blocks(&written, 3, |range, writer| {
            for i in 0..range.len() {
                writer.block(i).current().bricks().for_each(|brick| {
                    writer.brick(i, brick);
                });
            }
        });
        let ids: Vec<u32> = (0..40).filter(|id| id % 2 == 1 || id % 5 == 0).collect();
        let excerpt = field.excerpt(&ids);
        excerpt.assert_invariants();
        assert!(excerpt.len() == ids.len() && excerpt.resident_bricks() > 0 && excerpt.resident_bricks() == field.resident_bricks());
        for (here, &id) in (0..).zip(&ids) {
            let (ours, theirs) = (excerpt.block(here), field.block(id));
            assert!(excerpt.find(theirs.key) == Some(here) && (ours.scale, ours.finest) == (theirs.scale, theirs.finest));
            assert_eq!(excerpt.current(ours), field.current(theirs));
            assert_eq!(excerpt.colours.block(here), field.colours.block(id));
        }
        let absent = (0..40).filter(|id| !ids.contains(id)).all(|id| excerpt.find(field.block(id).key).is_none());
        assert!(absent && field.excerpt(&[]).is_empty());
    }
}
