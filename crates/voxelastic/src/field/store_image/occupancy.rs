//! The occupancy field's image: the octree's octants, parents first, then the voxels of the blocks among them.

use super::ImageError;
use crate::field::BlockStore;
use crate::field::occupancy::{OccupancyBlock, OccupancyField, Summary};
use crate::geometry::morton::AXIS_BITS;
use crate::octree::{NONE, Octant, Octree, Pool, SCALES, voxels_at};

/// An octant, without saying where things lie in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OctantRecord {
    /// Whether anything hangs below: its eight children, or at level 0 a block's voxels.
    pub linked: bool,
    /// What it knows of all that lies below.
    pub summary: Summary,
}

impl OccupancyField {
    /// All octants: the root, then depth first, each followed by all below it, siblings in Morton order. Empty for an
    /// empty field.
    pub fn octants_in_order(&self) -> Vec<OctantRecord> {
        let mut records = Vec::with_capacity(self.tree.octants());
        self.tree.for_each(|_, _, octant| records.push(OctantRecord { linked: octant.link != NONE, summary: octant.payload }));
        records
    }

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
}

/// Rebuilds an occupancy field from its image: first all octants, then the blocks' voxels in Morton order.
#[derive(Debug)]
pub struct OccupancyBuilder {
    tree: Octree<Summary>,
    blocks: Pool<OccupancyBlock>,
    voxels: BlockStore<i8>,
    /// Octants above level 0 whose children are being read, the innermost last.
    open: Vec<Open>,
    octants: usize,
    /// Where the blocks hang, in Morton order: group, place in it, key.
    waiting: Vec<(u32, u8, u64)>,
}

/// A group whose octants are being read.
#[derive(Clone, Copy, Debug)]
struct Open {
    group: u32,
    /// How many of its octants were read.
    read: u8,
    /// Level of its octants.
    level: u32,
    /// Key of the smallest block below it.
    key: u64,
}

impl OccupancyBuilder {
    /// Starts with the root: the cube of `level`, 1 to 21, whose smallest block has key `key`.
    ///
    /// # Errors
    /// [`ImageError::Root`].
    pub fn new(key: u64, level: u32, root: OctantRecord) -> Result<Self, ImageError> {
        if !(1..=AXIS_BITS).contains(&level) || key >> (3 * AXIS_BITS) != 0 || key.trailing_zeros() < 3 * level {
            return Err(ImageError::Root { key, level });
        }
        let tree = Octree::with_root(key, level, root.summary);
        let mut builder = Self { tree, blocks: Pool::default(), voxels: BlockStore::default(), open: Vec::new(), octants: 1, waiting: Vec::new() };
        if root.linked {
            let group = builder.open(level - 1, key);
            builder.tree.root_mut().link = group;
        }
        Ok(builder)
    }

    fn open(&mut self, level: u32, key: u64) -> u32 {
        let group = self.tree.add_group(Summary::default());
        self.open.push(Open { group, read: 0, level, key });
        group
    }

    /// Adds the next octant after the root in the order of [`OccupancyField::octants_in_order`].
    ///
    /// # Errors
    /// [`ImageError::Count`] when all octants that the others announce are there.
    pub fn push_octant(&mut self, record: OctantRecord) -> Result<(), ImageError> {
        let Some(open) = self.open.last_mut() else {
            return Err(ImageError::Count { of: "octants", got: self.octants + 1, expected: self.octants });
        };
        self.octants += 1;
        let (Open { group, level, .. }, place) = (*open, open.read);
        let key = open.key | u64::from(place) << (3 * level);
        open.read += 1;
        if open.read == 8 {
            self.open.pop();
        }
        let link = match (record.linked, level) {
            (false, _) => NONE,
            (true, 0) => {
                self.waiting.push((group, place, key));
                NONE
            }
            (true, _) => self.open(level - 1, key),
        };
        self.tree.siblings_mut(group)[usize::from(place)] = Octant { link, payload: record.summary };
        Ok(())
    }

    /// Adds the next block in Morton order: an array at `scale`.
    ///
    /// # Errors
    /// [`ImageError::Count`] when octants are missing or the blocks that they announce are all there,
    /// [`ImageError::Scale`] and [`ImageError::Length`] when scale and array are not a block's.
    pub fn push_block(&mut self, scale: u8, values: &[i8]) -> Result<(), ImageError> {
        self.check_octants()?;
        let id = self.blocks.capacity_used();
        let Some(&(group, place, key)) = self.waiting.get(id as usize) else {
            return Err(ImageError::Count { of: "blocks", got: id as usize + 1, expected: self.waiting.len() });
        };
        let level = usize::from(scale);
        if level >= SCALES {
            return Err(ImageError::Scale { key, scale, finest: scale });
        }
        if values.len() != voxels_at(level) {
            return Err(ImageError::Length { key, of: "voxels", got: values.len(), expected: voxels_at(level) });
        }
        let slot = self.voxels.insert(level);
        self.voxels.get_mut(level, slot).copy_from_slice(values);
        self.tree.siblings_mut(group)[usize::from(place)].link = self.blocks.insert(OccupancyBlock { key, slot, scale });
        Ok(())
    }

    fn check_octants(&self) -> Result<(), ImageError> {
        let missing: usize = self.open.iter().map(|open| 8 - usize::from(open.read)).sum();
        if missing == 0 { Ok(()) } else { Err(ImageError::Count { of: "octants", got: self.octants, expected: self.octants + missing }) }
    }

    /// The field.
    ///
    /// # Errors
    /// [`ImageError::Count`] when octants or blocks are missing.
    pub fn finish(self) -> Result<OccupancyField, ImageError> {
        self.check_octants()?;
        let got = self.blocks.live();
        if got != self.waiting.len() {
            return Err(ImageError::Count { of: "blocks", got, expected: self.waiting.len() });
        }
        Ok(OccupancyField { tree: self.tree, blocks: self.blocks, voxels: self.voxels })
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
            let id = field.make(&mut Cursor::new(&field.tree), key, scale);
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

    fn rebuilt(field: &OccupancyField) -> Result<OccupancyField, ImageError> {
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
        fn a_rebuilt_field_has_the_same_image(keys in prop::collection::vec(prop_oneof![4 => 0u64..5000, 1 => 0u64..1 << 63], 0..40), seed in any::<u64>()) {
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
    fn what_is_no_image_is_refused() {
        let leaf = OctantRecord { linked: false, summary: Summary::uniform(3) };
        let linked = OctantRecord { linked: true, ..leaf };
        for (key, level) in [(0, 0), (0, 22), (1, 1), (1 << 63, 1), (8, 2)] {
            assert_eq!(OccupancyBuilder::new(key, level, leaf).err(), Some(ImageError::Root { key, level }));
        }
        let count = |of, got, expected| Some(ImageError::Count { of, got, expected });
        let mut alone = OccupancyBuilder::new(8, 1, leaf).unwrap();
        assert_eq!(alone.push_octant(leaf).err(), count("octants", 2, 1));
        assert_eq!(alone.push_block(0, &[0; 512]).err(), count("blocks", 1, 0));
        assert!(alone.finish().is_ok_and(|field| field.value_at(crate::octree::block_coords(9).map(|c| 8 * c)) == 3));
        let mut builder = OccupancyBuilder::new(8, 1, linked).unwrap();
        builder.push_octant(linked).unwrap();
        assert_eq!(builder.push_block(3, &[1]).err(), count("octants", 2, 9));
        (0..7).for_each(|_| builder.push_octant(leaf).unwrap());
        assert_eq!(builder.push_block(4, &[1]).err(), Some(ImageError::Scale { key: 8, scale: 4, finest: 4 }));
        assert_eq!(builder.push_block(2, &[1]).err(), Some(ImageError::Length { key: 8, of: "voxels", got: 1, expected: 8 }));
        assert_eq!(builder.finish().err(), count("blocks", 0, 1));
    }
}
