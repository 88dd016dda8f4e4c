//! A tile of 32 x 32 x 32 cells, drawn from the voxels of all submaps around.
//!
//! Occupied is what any submap calls so; not free is what no submap knows to be free. Both are bits, and bits of submaps are joined row by row.

use super::raster::{Bits, Stencil, TurnedBox};
use super::{FREE, Node, OCCUPIED, Piece, Task};
use crate::field::occupancy::{State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, voxel_coords};
use crate::query::atlas::Part;
use crate::query::shape::moved;

/// Octree level of a tile, and its edge in cells.
pub const LEVEL: u32 = 2;
pub const EDGE: usize = BLOCK_EDGE << LEVEL;

/// A submap's voxels as boxes in a tile.
struct Pencil<'a, 'b> {
    part: &'a Part<'b>,
    stencil: Stencil,
    /// The tile's smallest corner, map frame, and a cell's edge: metres.
    corner: [f64; 3],
    cell: f64,
    /// Around the tile, finest voxels of the submap: the first, and the first beyond.
    low: [i32; 3],
    end: [i32; 3],
    /// What is occupied, and what nothing is known of.
    solid: Vec<TurnedBox>,
    unseen: Vec<TurnedBox>,
}

impl Task {
    /// Draws a tile.
    pub(super) fn draw(&self, node: &Node<'_, '_>, pieces: &mut Vec<Piece>) {
        let all = Bits([u32::MAX; EDGE * EDGE]);
        let (mut occupied, mut unseen) = (Bits([0; EDGE * EDGE]), all.clone());
        for part in &node.parts {
            let mut pencil = Pencil::new(self, part, node);
            pencil.collect();
            let mut solid = Bits([0; EDGE * EDGE]);
            pencil.draw(&pencil.solid, &all, &mut solid);
            let mut blocked = solid.clone();
            // What others know to be free is not asked again.
            pencil.draw(&pencil.unseen, &unseen, &mut blocked);
            for row in 0..EDGE * EDGE {
                occupied.0[row] |= solid.0[row];
                unseen.0[row] &= blocked.0[row];
            }
        }
        for i in 0..1 << (3 * LEVEL) {
            pieces.extend(piece(node.key | i, &occupied, &unseen));
        }
    }
}

/// A block of a tile; none when nothing is known of it.
fn piece(key: u64, occupied: &Bits, unseen: &Bits) -> Option<Piece> {
    let place = crate::geometry::morton::decode(key).map(|c| (c as usize & ((1 << LEVEL) - 1)) * BLOCK_EDGE);
    let mut values = Box::new([FREE; BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE]);
    for (i, row) in values.as_chunks_mut::<BLOCK_EDGE>().0.iter_mut().enumerate() {
        let at = place[1] + i % BLOCK_EDGE + EDGE * (place[2] + i / BLOCK_EDGE);
        let (solid, blocked) = (occupied.0[at] >> place[0], unseen.0[at] >> place[0]);
        for (x, value) in row.iter_mut().enumerate() {
            if solid >> x & 1 == 1 {
                *value = OCCUPIED;
            } else if blocked >> x & 1 == 1 {
                *value = UNKNOWN;
            }
        }
    }
    let first = values[0];
    match values.iter().all(|v| *v == first) {
        true if first == UNKNOWN => None,
        true => Some(Piece::Uniform { key, level: 0, value: first }),
        false => Some(Piece::Cells { key, values }),
    }
}

impl<'a, 'b> Pencil<'a, 'b> {
    fn new(task: &Task, part: &'a Part<'b>, node: &Node<'_, '_>) -> Self {
        let (corner, edge) = task.cube(node.key, node.level);
        let middle = moved(&part.t_submap_map, corner.map(|c| c + 0.5 * edge));
        let rotation = part.t_submap_map.rotation.to_rotation_matrix();
        let reach: [f64; 3] = std::array::from_fn(|k| (0..3).map(|j| rotation[(k, j)].abs()).sum::<f64>() * 0.5 * edge);
        let voxel = |k: usize, side: f64| ((middle[k] + side * reach[k]) * part.query.per_metre).floor() as i32;
        Self {
            part,
            stencil: Stencil::new(&part.t_map_submap.rotation.to_rotation_matrix()),
            corner,
            cell: task.cell,
            low: std::array::from_fn(|k| voxel(k, -1.0)),
            end: std::array::from_fn(|k| voxel(k, 1.0) + 1),
            solid: Vec::new(),
            unseen: Vec::new(),
        }
    }

    /// Looks for all that is not free around the tile.
    fn collect(&mut self) {
        let tree = self.part.query.field.tree();
        let corner = block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT);
        let edge = (BLOCK_EDGE as i32) << tree.root_level();
        self.beyond(corner, edge);
        self.look(tree.root(), corner, tree.root_level());
    }

    /// Space outside of the root cube is unseen: a box on each side that the tile reaches beyond.
    fn beyond(&mut self, corner: [i32; 3], edge: i32) {
        for k in 0..3 {
            let (mut low, mut size) = (self.low, [0, 1, 2].map(|j| self.end[j] - self.low[j]));
            if self.low[k] < corner[k] {
                size[k] = corner[k].min(self.end[k]) - self.low[k];
                self.push(State::Unknown, low, size);
            }
            if self.end[k] > corner[k] + edge {
                low[k] = self.low[k].max(corner[k] + edge);
                size[k] = self.end[k] - low[k];
                self.push(State::Unknown, low, size);
            }
        }
    }

    fn look(&mut self, octant: &Octant<Summary>, corner: [i32; 3], level: u32) {
        let edge = (BLOCK_EDGE << level) as i32;
        let summary = octant.payload;
        let is_apart = (0..3).any(|k| corner[k] >= self.end[k] || corner[k] + edge <= self.low[k]);
        if is_apart || (summary.observed && summary.max < 0) {
            return;
        }
        if octant.link == NONE || summary.max == UNKNOWN {
            self.push(state_of(if octant.link == NONE { summary.value } else { UNKNOWN }), corner, [edge; 3]);
        } else if level == 0 {
            self.look_into(octant.link, corner);
        } else {
            for (i, child) in self.part.query.field.tree().siblings(octant.link).iter().enumerate() {
                self.look(child, std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 }), level - 1);
            }
        }
    }

    /// A block's voxels near the tile, as few boxes.
    fn look_into(&mut self, id: u32, corner: [i32; 3]) {
        let block = self.part.query.field.block(id);
        let (values, scale) = (self.part.query.field.values(block), usize::from(block.scale));
        let mut masks = [[0u64; BLOCK_EDGE]; 2];
        for (i, &value) in values.iter().enumerate() {
            let c = voxel_coords(i, scale);
            let is_near = (0..3).all(|k| {
                let low = corner[k] + (c[k] << scale) as i32;
                low < self.end[k] && low + (1 << scale) > self.low[k]
            });
            let kind = match state_of(value) {
                State::Free => continue,
                State::Occupied => 0,
                State::Unknown => 1,
            };
            masks[kind][c[2]] |= u64::from(is_near) << (c[0] + BLOCK_EDGE * c[1]);
        }
        for (mask, state) in masks.iter_mut().zip([State::Occupied, State::Unknown]) {
            boxes(mask, |low, size| {
                let low = std::array::from_fn(|k| corner[k] + (low[k] << scale) as i32);
                self.push(state, low, size.map(|s| (s << scale) as i32));
            });
        }
    }

    /// Notes a box: smallest corner and edges in finest voxels of the submap.
    fn push(&mut self, state: State, low: [i32; 3], size: [i32; 3]) {
        // No larger than what is around the tile, so that single precision does.
        let first: [i32; 3] = std::array::from_fn(|k| low[k].max(self.low[k]));
        let end: [i32; 3] = std::array::from_fn(|k| (low[k] + size[k]).min(self.end[k]));
        let voxel = self.part.query.voxel;
        let middle = moved(&self.part.t_map_submap, std::array::from_fn(|k| 0.5 * (f64::from(first[k]) + f64::from(end[k])) * voxel));
        let drawn = TurnedBox {
            centre: std::array::from_fn(|k| ((middle[k] - self.corner[k]) / self.cell) as f32),
            half: std::array::from_fn(|k| (0.5 * f64::from(end[k] - first[k]) * voxel / self.cell) as f32),
        };
        if state == State::Occupied { &mut self.solid } else { &mut self.unseen }.push(drawn);
    }

    fn draw(&self, boxes: &[TurnedBox], within: &Bits, bits: &mut Bits) {
        boxes.iter().for_each(|what| self.stencil.draw(what, within, bits));
    }
}

/// Takes all bits out of a block's mask (a word for each z, bit x + 8 y), as few boxes: smallest corner and edges.
fn boxes(mask: &mut [u64; BLOCK_EDGE], mut give: impl FnMut([usize; 3], [usize; 3])) {
    for z in 0..BLOCK_EDGE {
        while mask[z] != 0 {
            let at = mask[z].trailing_zeros() as usize;
            let (x, y) = (at % BLOCK_EDGE, at / BLOCK_EDGE);
            let row = |y: usize| mask[z] >> (BLOCK_EDGE * y) & 0xff;
            let along = (row(y) >> x).trailing_ones() as usize;
            let run = ((1 << along) - 1) << x;
            let across = (y..BLOCK_EDGE).take_while(|y| row(*y) & run == run).count();
            let face = (y..y + across).fold(0, |face, y| face | run << (BLOCK_EDGE * y));
            let up = (z..BLOCK_EDGE).take_while(|z| mask[*z] & face == face).count();
            mask[z..z + up].iter_mut().for_each(|slice| *slice &= !face);
            give([x, y, z], [along, across, up]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn boxes_hold_every_bit_once(mut mask in prop::array::uniform8(any::<u64>()), other in prop::array::uniform8(any::<u64>()), dense in any::<bool>()) {
            mask.iter_mut().zip(other).for_each(|(a, b)| if dense { *a |= b } else { *a &= b });
            let (expected, mut got) = (mask, [0u64; BLOCK_EDGE]);
            boxes(&mut mask, |low, size| {
                for i in 0..size[0] * size[1] * size[2] {
                    let c = [low[0] + i % size[0], low[1] + i / size[0] % size[1], low[2] + i / size[0] / size[1]];
                    let bit = 1 << (c[0] + BLOCK_EDGE * c[1]);
                    assert_eq!(got[c[2]] & bit, 0);
                    got[c[2]] |= bit;
                }
            });
            prop_assert_eq!(got, expected);
            prop_assert_eq!(mask, [0; BLOCK_EDGE]);
        }
    }
}
