//! Volume of free and occupied space, by the size of the cubes that store it.

use super::field::OccupancyField;
use super::value::{State, state_of};
use crate::octree::{BLOCK_SHIFT, NONE, Octant};

/// Volume of known space, finest voxels; element i is the volume stored in cubes with an edge of 2^i finest voxels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Volumes {
    /// Free space.
    pub free: Vec<u64>,
    /// Occupied space.
    pub occupied: Vec<u64>,
}

impl Volumes {
    /// Adds another field's volumes.
    pub fn add(&mut self, other: &Self) {
        for (mine, theirs) in [(&mut self.free, &other.free), (&mut self.occupied, &other.occupied)] {
            mine.resize(mine.len().max(theirs.len()), 0);
            mine.iter_mut().zip(theirs).for_each(|(a, b)| *a += b);
        }
    }

    fn count(&mut self, value: i8, edge_log2: u32, cubes: u64) {
        let list = match state_of(value) {
            State::Unknown => return,
            State::Free => &mut self.free,
            State::Occupied => &mut self.occupied,
        };
        let edge_log2 = edge_log2 as usize;
        list.resize(list.len().max(edge_log2 + 1), 0);
        list[edge_log2] += cubes << (3 * edge_log2);
    }
}

impl OccupancyField {
    /// Volume of all known space.
    pub fn volumes(&self) -> Volumes {
        let mut volumes = Volumes::default();
        let mut stack = vec![(*self.tree.root(), self.tree.root_level())];
        while let Some((Octant { link, payload }, level)) = stack.pop() {
            if link == NONE {
                volumes.count(payload.value, level + BLOCK_SHIFT, 1);
            } else if level > 0 {
                stack.extend(self.tree.siblings(link).iter().map(|&child| (child, level - 1)));
            } else {
                let block = self.block(link);
                self.values(block).iter().for_each(|&value| volumes.count(value, u32::from(block.scale), 1));
            }
        }
        volumes
    }
}
