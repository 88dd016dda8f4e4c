//! The occupancy field: uniform octants of any size, and blocks of voxels where space is not uniform.

use super::change_log::{ChangeLog, Flip};
use super::value::{State, Summary, UNKNOWN, state_of};
use crate::field::block_store::BlockStore;
use crate::octree::{BLOCK_SHIFT, Cursor, NONE, Octree, Pool, SCALES, block_key, voxel_index, voxels_at};

/// A block that is not uniform: its position and its array of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OccupancyBlock {
    /// Morton key of its position, see [`block_key`].
    pub key: u64,
    /// Slot of its array in the field's store.
    pub(crate) slot: u32,
    /// Scale of its array, 0 to 3: the edge of its voxels is 2^scale finest voxels.
    pub scale: u8,
}

/// A cube with one value: a uniform octant or a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaf {
    /// Log-odds in steps, or [`UNKNOWN`].
    pub value: i8,
    /// log2 of the cube's edge in finest voxels.
    pub edge_log2: u32,
}

/// An occupancy field over an octree of blocks, in the frame of a submap.
#[derive(Clone, Debug, Default)]
pub struct OccupancyField {
    pub(crate) tree: Octree<Summary>,
    pub(crate) blocks: Pool<OccupancyBlock>,
    pub(crate) voxels: BlockStore<i8>,
    pub(crate) changes: ChangeLog,
}

impl OccupancyField {
    /// Whether no space has been observed.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }

    /// The octree. An octant of level 0 links to a block, unless it is uniform.
    pub fn tree(&self) -> &Octree<Summary> {
        &self.tree
    }

    /// Number of blocks that are not uniform.
    pub fn len(&self) -> usize {
        self.blocks.live()
    }

    /// The block with id `id`.
    #[inline(always)]
    pub fn block(&self, id: u32) -> &OccupancyBlock {
        &self.blocks[id]
    }

    /// Log-odds of the voxels of `block` at its scale, in steps, in the order of [`voxel_index`].
    #[inline(always)]
    pub fn values(&self, block: &OccupancyBlock) -> &[i8] {
        self.voxels.get(usize::from(block.scale), block.slot)
    }

    /// The stored cube that contains the finest voxel at `c` (finest voxels, submap frame); none outside of the root cube.
    pub fn leaf_at(&self, c: [i32; 3]) -> Option<Leaf> {
        let (level, octant) = self.tree.find(block_key(c.map(|v| v >> BLOCK_SHIFT)))?;
        if octant.link == NONE {
            return Some(Leaf { value: octant.payload.value, edge_log2: level + BLOCK_SHIFT });
        }
        let block = &self.blocks[octant.link];
        let local = c.map(|v| (v & 7) as usize >> block.scale);
        Some(Leaf { value: self.values(block)[voxel_index(local, usize::from(block.scale))], edge_log2: u32::from(block.scale) })
    }

    /// Log-odds of the finest voxel at `c` (finest voxels, submap frame), in steps; [`UNKNOWN`] outside of the root cube.
    pub fn value_at(&self, c: [i32; 3]) -> i8 {
        self.leaf_at(c).map_or(UNKNOWN, |leaf| leaf.value)
    }

    /// State of the finest voxel at `c` (finest voxels, submap frame).
    pub fn state_at(&self, c: [i32; 3]) -> State {
        state_of(self.value_at(c))
    }

    /// Finds block `key`, or creates it from the uniform octant that contains it, and refines it to `scale` if it is coarser. Returns its
    /// id. The tree's root must cover the key.
    pub(crate) fn find_or_create(&mut self, cursor: &mut Cursor, key: u64, scale: usize) -> u32 {
        let octant = cursor.find_or_create(&mut self.tree, key);
        self.find_or_create_in(octant, key, scale)
    }

    /// As [`find_or_create`](Self::find_or_create), for block `key` whose octant is number `index` of group `group`.
    pub(crate) fn find_or_create_in(&mut self, (group, index): (u32, usize), key: u64, scale: usize) -> u32 {
        let octant = self.tree.siblings(group)[index];
        if octant.link != NONE {
            self.refine(octant.link, scale);
            return octant.link;
        }
        let slot = self.voxels.insert(scale);
        self.voxels.get_mut(scale, slot).fill(octant.payload.value);
        let id = self.blocks.insert(OccupancyBlock { key, slot, scale: scale as u8 });
        self.tree.siblings_mut(group)[index].link = id;
        id
    }

    /// Refines block `id` to `scale` if it is coarser: voxels get the value of the coarser voxel around them.
    fn refine(&mut self, id: u32, scale: usize) {
        let block = self.blocks[id];
        let from = usize::from(block.scale);
        if scale >= from {
            return;
        }
        let slot = self.voxels.insert(scale);
        let mut values = [UNKNOWN; voxels_at(0)];
        values[..voxels_at(from)].copy_from_slice(self.voxels.get(from, block.slot));
        for scale in (scale..from).rev() {
            values = match scale {
                0 => subdivide::<4>(&values),
                1 => subdivide::<2>(&values),
                _ => subdivide::<1>(&values),
            };
        }
        self.voxels.get_mut(scale, slot).copy_from_slice(&values[..voxels_at(scale)]);
        self.voxels.remove(from, block.slot);
        self.blocks[id] = OccupancyBlock { slot, scale: scale as u8, ..block };
    }

    /// Frees block `id`, whose octant has become uniform.
    pub(crate) fn remove(&mut self, id: u32) {
        let block = self.blocks[id];
        self.voxels.remove(usize::from(block.scale), block.slot);
        self.blocks.remove(id);
    }

    /// Number of the latest change of the field. Unique in the process, not stored.
    pub fn revision(&self) -> u64 {
        self.changes.revision()
    }

    /// The octants in which voxels changed their state since the field had this revision; none if that is not known any more, so that anything may have changed.
    pub fn changes_since(&self, revision: u64) -> Option<impl Iterator<Item = &Flip>> {
        self.changes.since(revision)
    }

    /// Number of blocks at each scale.
    pub fn arrays(&self) -> [usize; SCALES] {
        self.voxels.live()
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.tree.bytes() + self.blocks.bytes() + self.voxels.bytes() + self.changes.bytes()
    }
}

/// Subdivides the voxels of a block with `EDGE` voxels along each axis; children get their parent's value.
fn subdivide<const EDGE: usize>(coarse: &[i8; voxels_at(0)]) -> [i8; voxels_at(0)] {
    let mut fine = [UNKNOWN; voxels_at(0)];
    for (i, values) in coarse[..EDGE * EDGE * EDGE].as_chunks::<EDGE>().0.iter().enumerate() {
        let (y, z) = (i % EDGE, i / EDGE);
        // The row is repeated four times.
        for (y, z) in [(2 * y, 2 * z), (2 * y + 1, 2 * z), (2 * y, 2 * z + 1), (2 * y + 1, 2 * z + 1)] {
            let row = (z * 2 * EDGE + y) * 2 * EDGE;
            let pairs = fine[row..row + 2 * EDGE].as_chunks_mut::<2>().0;
            pairs.iter_mut().zip(values).for_each(|(pair, &value)| *pair = [value; 2]);
        }
    }
    fine
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::voxel_coords;

    #[test]
    fn refining_a_block_copies_values_to_children() {
        let key = block_key([3, -1, 2]);
        for from in 1..SCALES {
            for to in 0..from {
                let mut field = OccupancyField::default();
                field.tree.grow_to(key);
                let mut cursor = Cursor::new(&field.tree);
                let id = field.find_or_create(&mut cursor, key, from);
                let slot = field.blocks[id].slot;
                let coarse: Vec<i8> = (0..voxels_at(from)).map(|i| (i * 37 % 127) as i8).collect();
                field.voxels.get_mut(from, slot).copy_from_slice(&coarse);
                assert_eq!(field.find_or_create(&mut cursor, key, to), id);
                let fine = field.values(field.block(id));
                assert_eq!(fine.len(), voxels_at(to));
                for (i, value) in fine.iter().enumerate() {
                    let parent = voxel_index(voxel_coords(i, to).map(|c| c >> (from - to)), from);
                    assert_eq!(*value, coarse[parent], "voxel {i}, {from} to {to}");
                }
                assert_eq!(field.arrays().iter().sum::<usize>(), 1);
            }
        }
    }
}
