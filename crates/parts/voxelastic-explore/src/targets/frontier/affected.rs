//! The blocks whose frontier a change may have changed.

use super::{States, SubmapFrontier, at_face};
use voxelastic::field::occupancy::{OccupancyField, State, state_of};
use voxelastic::octree::{MAX_BLOCK_COORD, NONE, block_coords, block_key};

/// Axes and sides of the faces of a cube.
const FACES: [(usize, i32); 6] = [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)];

impl SubmapFrontier {
    /// Adds the keys of a block that has changed and of its neighbours whose frontier may have: those that have one, and those next to something unknown in it.
    pub(super) fn add_block(&self, states: &mut States<'_>, key: u64, blocks: &mut Vec<u64>) {
        blocks.push(key);
        let (block, unknown) = (block_coords(key), states.of(key).unknown());
        for (axis, side) in FACES {
            let mut neighbour = block;
            neighbour[axis] += side;
            let is_inside = neighbour[axis].abs() < MAX_BLOCK_COORD;
            if is_inside && (at_face(&unknown, axis, side) || self.blocks.contains_key(&block_key(neighbour))) {
                blocks.push(block_key(neighbour));
            }
        }
    }

    /// The same for an octant in which all has changed: what it costs follows the frontier there, and not the size of the octant.
    pub(super) fn add_octant(&self, field: &OccupancyField, key: u64, level: u32, blocks: &mut Vec<u64>) {
        let (low, edge) = (block_coords(key), 1i32 << level);
        let own = uniform(field, low, level);
        if !matches!(own, Some(State::Free | State::Occupied)) {
            add_faces(blocks, low, edge);
            return;
        }
        let in_octant = |low: [i32; 3]| {
            let first = block_key(low);
            self.blocks.range(first..first + (1 << (3 * level))).map(|(key, _)| *key)
        };
        blocks.extend(in_octant(low));
        for (axis, side) in FACES {
            let (mut neighbour, mut face) = (low, low);
            neighbour[axis] += side * edge;
            face[axis] += if side > 0 { edge - 1 } else { 0 };
            if neighbour[axis].abs() < MAX_BLOCK_COORD {
                let layer = face[axis] + side;
                blocks.extend(in_octant(neighbour).filter(|key| block_coords(*key)[axis] == layer));
            }
            if own == Some(State::Free) {
                add_next_to_unknown(field, face, (axis, side), level, blocks);
            }
        }
    }
}

/// The state of an octant, if it is uniform.
fn uniform(field: &OccupancyField, low: [i32; 3], level: u32) -> Option<State> {
    if low.iter().any(|c| c.abs() >= MAX_BLOCK_COORD) {
        return Some(State::Unknown);
    }
    let Some((found, octant)) = field.tree().find(block_key(low)) else { return Some(State::Unknown) };
    (octant.link == NONE && found >= level).then(|| state_of(octant.payload.value))
}

/// Adds the keys of the blocks in a square of 4^level blocks, the first one of them `low`, that are next to something unknown beyond the face.
fn add_next_to_unknown(field: &OccupancyField, low: [i32; 3], (axis, side): (usize, i32), level: u32, blocks: &mut Vec<u64>) {
    let mut beyond = low;
    beyond[axis] += side;
    let edge = 1i32 << level;
    match uniform(field, beyond, level) {
        Some(State::Unknown) => (0..edge * edge).for_each(|i| blocks.push(block_key(in_square(low, axis, [i % edge, i / edge])))),
        Some(_) => {}
        None if level == 0 => blocks.push(block_key(low)),
        None => {
            let half = edge / 2;
            for at in [[0, 0], [half, 0], [0, half], [half, half]] {
                add_next_to_unknown(field, in_square(low, axis, at), (axis, side), level - 1, blocks);
            }
        }
    }
}

/// The block at a place of a square across an axis.
fn in_square(low: [i32; 3], axis: usize, at: [i32; 2]) -> [i32; 3] {
    let mut block = low;
    block[(axis + 1) % 3] += at[0];
    block[(axis + 2) % 3] += at[1];
    block
}

/// Adds the keys of the blocks at the faces of an octant of `edge` blocks, on both sides: nothing changes within it, and nothing beyond.
fn add_faces(blocks: &mut Vec<u64>, low: [i32; 3], edge: i32) {
    for axis in 0..3 {
        for depth in [-1, 0, edge - 1, edge] {
            for i in 0..edge * edge {
                let mut block = in_square(low, axis, [i % edge, i / edge]);
                block[axis] += depth;
                if block.iter().all(|c| c.abs() < MAX_BLOCK_COORD) {
                    blocks.push(block_key(block));
                }
            }
        }
    }
}
