//! The snapshot of an occupancy field: all octants of the octree, parents first, then the voxels of the blocks in Morton order.

use super::SnapshotError;
use crate::field::block_store::BlockStore;
use crate::field::occupancy::{OccupancyBlock, OccupancyField, Summary};
use crate::geometry::morton::AXIS_BITS;
use crate::octree::{NONE, Octant, Octree, Pool, SCALES, voxels_at};

/// An octant, without references to memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OctantRecord {
    /// Whether it has eight children or, at level 0, a block of voxels.
    pub linked: bool,
    /// Its summary of the subtree.
    pub summary: Summary,
}

impl OccupancyField {
    /// All octants in depth-first order: the root, then each octant followed by its subtree, siblings in Morton order. Empty for an
    /// empty field.
    pub fn octants_in_order(&self) -> Vec<OctantRecord> {
        let mut records = Vec::with_capacity(self.tree.octants());
        self.tree.for_each(|_, _, octant| records.push(OctantRecord { linked: octant.link != NONE, summary: octant.payload }));
        records
    }

    /// Ids of all blocks in ascending order of their Morton keys.
    pub fn ids_in_morton_order(&self) -> Vec<u32> {
        self.tree.block_ids()
    }
}

/// Rebuilds an occupancy field from its snapshot: first all octants, then the voxels of the blocks in Morton order.
#[derive(Debug)]
pub struct OccupancyBuilder {
    tree: Octree<Summary>,
    blocks: Pool<OccupancyBlock>,
    voxels: BlockStore<i8>,
    /// The groups on the path to the next octant, the innermost last.
    path: Vec<Group>,
    octants: usize,
    /// The octants that link to blocks, in Morton order: group, index in it, key.
    block_octants: Vec<(u32, u8, u64)>,
}

/// A group of which some octants are still missing.
#[derive(Clone, Copy, Debug)]
struct Group {
    index: u32,
    /// Number of its octants read so far.
    read: u8,
    /// Level of its octants.
    level: u32,
    /// Key of its first block.
    key: u64,
}

impl OccupancyBuilder {
    /// Starts with the root: the cube of `level`, 1 to 21, whose first block has key `key`.
    ///
    /// # Errors
    /// [`SnapshotError::Root`] if no octree can have this root.
    pub fn new(key: u64, level: u32, root: OctantRecord) -> Result<Self, SnapshotError> {
        if !(1..=AXIS_BITS).contains(&level) || key >> (3 * AXIS_BITS) != 0 || key.trailing_zeros() < 3 * level {
            return Err(SnapshotError::Root { key, level });
        }
        let tree = Octree::with_root(key, level, root.summary);
        let mut builder =
            Self { tree, blocks: Pool::default(), voxels: BlockStore::default(), path: Vec::new(), octants: 1, block_octants: Vec::new() };
        if root.linked {
            let group = builder.add_group(level - 1, key);
            builder.tree.root_mut().link = group;
        }
        Ok(builder)
    }

    fn add_group(&mut self, level: u32, key: u64) -> u32 {
        let index = self.tree.add_group(Summary::default());
        self.path.push(Group { index, read: 0, level, key });
        index
    }

    /// Adds the next octant after the root in the order of [`OccupancyField::octants_in_order`].
    ///
    /// # Errors
    /// [`SnapshotError::Count`] if the tree is complete already.
    pub fn push_octant(&mut self, record: OctantRecord) -> Result<(), SnapshotError> {
        let Some(parent) = self.path.last_mut() else {
            return Err(SnapshotError::Count { of: "octants", got: self.octants + 1, expected: self.octants });
        };
        self.octants += 1;
        let (Group { index: group, level, .. }, index) = (*parent, parent.read);
        let key = parent.key | u64::from(index) << (3 * level);
        parent.read += 1;
        if parent.read == 8 {
            self.path.pop();
        }
        let link = match (record.linked, level) {
            (false, _) => NONE,
            (true, 0) => {
                self.block_octants.push((group, index, key));
                NONE
            }
            (true, _) => self.add_group(level - 1, key),
        };
        self.tree.siblings_mut(group)[usize::from(index)] = Octant { link, payload: record.summary };
        Ok(())
    }

    /// Adds the next block in Morton order: `values` is its array at `scale`, x fastest.
    ///
    /// # Errors
    /// [`SnapshotError::Count`] if octants are missing or no further block is expected; [`SnapshotError::Scale`] and
    /// [`SnapshotError::Length`] if scale or length is wrong.
    pub fn push_block(&mut self, scale: u8, values: &[i8]) -> Result<(), SnapshotError> {
        self.check_octants()?;
        let id = self.blocks.capacity_used();
        let Some(&(group, index, key)) = self.block_octants.get(id as usize) else {
            return Err(SnapshotError::Count { of: "blocks", got: id as usize + 1, expected: self.block_octants.len() });
        };
        let level = usize::from(scale);
        if level >= SCALES {
            return Err(SnapshotError::Scale { key, scale, finest: scale });
        }
        if values.len() != voxels_at(level) {
            return Err(SnapshotError::Length { key, of: "voxels", got: values.len(), expected: voxels_at(level) });
        }
        let slot = self.voxels.insert(level);
        self.voxels.get_mut(level, slot).copy_from_slice(values);
        self.tree.siblings_mut(group)[usize::from(index)].link = self.blocks.insert(OccupancyBlock { key, slot, scale });
        Ok(())
    }

    fn check_octants(&self) -> Result<(), SnapshotError> {
        let missing: usize = self.path.iter().map(|group| 8 - usize::from(group.read)).sum();
        if missing == 0 { Ok(()) } else { Err(SnapshotError::Count { of: "octants", got: self.octants, expected: self.octants + missing }) }
    }

    /// Returns the field.
    ///
    /// # Errors
    /// [`SnapshotError::Count`] if octants or blocks are missing.
    pub fn finish(self) -> Result<OccupancyField, SnapshotError> {
        self.check_octants()?;
        let got = self.blocks.live();
        if got != self.block_octants.len() {
            return Err(SnapshotError::Count { of: "blocks", got, expected: self.block_octants.len() });
        }
        let mut field = OccupancyField { tree: self.tree, blocks: self.blocks, voxels: self.voxels, ..OccupancyField::default() };
        field.changes.push_unknown();
        Ok(field)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::Cursor;
    use proptest::prelude::*;

    /// A field with blocks at `keys`, whose octants and voxels hold arbitrary values.
    fn field_of(keys: &[u64], seed: u64) -> OccupancyField {
        let mut number = seed;
        let mut next = move || {
            number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (number >> 56) as i8
        };
        let mut field = OccupancyField::default();
        for &key in keys {
            field.tree.grow_to(key);
            let scale = (next() & 3) as usize;
            let id = field.find_or_create(&mut Cursor::new(&field.tree), key, scale);
            let block = *field.block(id);
            field.voxels.get_mut(usize::from(block.scale), block.slot).fill_with(&mut next);
        }
        let mut octants = Vec::new();
        field.tree.for_each(|key, level, _| octants.push((key, level)));
        for (key, level) in octants {
            let payload = Summary { value: next(), max: next(), observed: next() < 0 };
            if let Some(octant) = field.tree.octant_mut(key, level) {
                octant.payload = payload;
            }
        }
        field
    }

    fn rebuilt(field: &OccupancyField) -> Result<OccupancyField, SnapshotError> {
        let octants = field.octants_in_order();
        let Some((root, others)) = octants.split_first() else { return Ok(OccupancyField::default()) };
        let mut builder = OccupancyBuilder::new(field.tree.root_key(), field.tree.root_level(), *root)?;
        others.iter().try_for_each(|&octant| builder.push_octant(octant))?;
        for id in field.ids_in_morton_order() {
            let block = field.block(id);
            builder.push_block(block.scale, field.values(block))?;
        }
        builder.finish()
    }

    proptest! {
        #[test]
        fn a_rebuilt_field_has_the_same_snapshot(keys in prop::collection::vec(prop_oneof![4 => 0u64..5000, 1 => 0u64..1 << 63], 0..40), seed in any::<u64>()) {
            let field = field_of(&keys, seed);
            let same = rebuilt(&field).unwrap();
            prop_assert_eq!((same.tree.root_key(), same.tree.root_level()), (field.tree.root_key(), field.tree.root_level()));
            prop_assert_eq!(same.octants_in_order(), field.octants_in_order());
            prop_assert_eq!((same.tree.octants(), same.len()), (field.tree.octants(), field.len()));
            for &key in &keys {
                let of = |f: &OccupancyField| f.tree.block(key).map(|id| (f.block(id).key, f.block(id).scale, f.values(f.block(id)).to_vec()));
                prop_assert_eq!(of(&same), of(&field));
            }
        }
    }

    #[test]
    fn invalid_snapshots_are_rejected() {
        let leaf = OctantRecord { linked: false, summary: Summary::uniform(3) };
        let linked = OctantRecord { linked: true, ..leaf };
        for (key, level) in [(0, 0), (0, 22), (1, 1), (1 << 63, 1), (8, 2)] {
            assert_eq!(OccupancyBuilder::new(key, level, leaf).err(), Some(SnapshotError::Root { key, level }));
        }
        let count = |of, got, expected| Some(SnapshotError::Count { of, got, expected });
        let mut alone = OccupancyBuilder::new(8, 1, leaf).unwrap();
        assert_eq!(alone.push_octant(leaf).err(), count("octants", 2, 1));
        assert_eq!(alone.push_block(0, &[0; 512]).err(), count("blocks", 1, 0));
        assert!(alone.finish().is_ok_and(|field| field.value_at(crate::octree::block_coords(9).map(|c| 8 * c)) == 3));
        let mut builder = OccupancyBuilder::new(8, 1, linked).unwrap();
        builder.push_octant(linked).unwrap();
        assert_eq!(builder.push_block(3, &[1]).err(), count("octants", 2, 9));
        (0..7).for_each(|_| builder.push_octant(leaf).unwrap());
        assert_eq!(builder.push_block(4, &[1]).err(), Some(SnapshotError::Scale { key: 8, scale: 4, finest: 4 }));
        assert_eq!(builder.push_block(2, &[1]).err(), Some(SnapshotError::Length { key: 8, of: "voxels", got: 1, expected: 8 }));
        assert_eq!(builder.finish().err(), count("blocks", 0, 1));
    }
}
