//! A tile of 32 x 32 x 32 cells, rasterised from the voxels of all submaps around it.
//!
//! A cell is occupied if it is in any submap, and free if it is in some submap and occupied in none. Both are bit masks, combined row by row.

use super::box_raster::{BoxRaster, RotatedBox};
use super::grid::{FREE, Grid, MergedItem, Node, OCCUPIED};
use super::tile_mask::{TILE_EDGE, TILE_LEVEL, TileMask};
use crate::field::occupancy::{State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, voxel_coords};
use crate::query::atlas::PlacedField;
use crate::query::shape::moved;

/// A submap's voxels around a tile as boxes in it.
struct TileBoxes<'a, 'b> {
    part: &'a PlacedField<'b>,
    raster: BoxRaster,
    /// The tile's first corner in the map frame and the edge of a cell, metres.
    corner: [f64; 3],
    cell: f64,
    /// Bounds of the tile, finest voxels of the submap: the first, and the first beyond.
    low: [i32; 3],
    end: [i32; 3],
    occupied: Vec<RotatedBox>,
    unknown: Vec<RotatedBox>,
}

/// Rasterises a tile: appends its blocks.
pub(super) fn rasterise_tile(grid: &Grid, node: &Node<'_, '_>, items: &mut Vec<MergedItem>) {
    let all = TileMask([u32::MAX; TILE_EDGE * TILE_EDGE]);
    // Cells that are free in no submap so far.
    let (mut occupied, mut not_free) = (TileMask([0; TILE_EDGE * TILE_EDGE]), all.clone());
    for part in &node.parts {
        let mut boxes = TileBoxes::new(grid, part, node);
        boxes.collect();
        let mut own_occupied = TileMask([0; TILE_EDGE * TILE_EDGE]);
        boxes.fill(&boxes.occupied, &all, &mut own_occupied);
        let mut blocked = own_occupied.clone();
        // Rows that are free in other submaps need no unknown voxels.
        boxes.fill(&boxes.unknown, &not_free, &mut blocked);
        for row in 0..TILE_EDGE * TILE_EDGE {
            occupied.0[row] |= own_occupied.0[row];
            not_free.0[row] &= blocked.0[row];
        }
    }
    for i in 0..1 << (3 * TILE_LEVEL) {
        items.extend(block_item(node.key | i, &occupied, &not_free));
    }
}

/// A block of a tile; none if all of it is unknown.
fn block_item(key: u64, occupied: &TileMask, not_free: &TileMask) -> Option<MergedItem> {
    let corner = crate::geometry::morton::decode(key).map(|c| (c as usize & ((1 << TILE_LEVEL) - 1)) * BLOCK_EDGE);
    let mut values = Box::new([FREE; BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE]);
    for (i, row) in values.as_chunks_mut::<BLOCK_EDGE>().0.iter_mut().enumerate() {
        let row_index = corner[1] + i % BLOCK_EDGE + TILE_EDGE * (corner[2] + i / BLOCK_EDGE);
        let (solid, blocked) = (occupied.0[row_index] >> corner[0], not_free.0[row_index] >> corner[0]);
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
        true => Some(MergedItem::Uniform { key, level: 0, value: first }),
        false => Some(MergedItem::Cells { key, values }),
    }
}

impl<'a, 'b> TileBoxes<'a, 'b> {
    fn new(grid: &Grid, part: &'a PlacedField<'b>, node: &Node<'_, '_>) -> Self {
        let (corner, edge) = grid.cube(node.key, node.level);
        let middle = moved(&part.t_submap_map, corner.map(|c| c + 0.5 * edge));
        let rotation = part.t_submap_map.rotation.to_rotation_matrix();
        let reach: [f64; 3] = std::array::from_fn(|k| (0..3).map(|j| rotation[(k, j)].abs()).sum::<f64>() * 0.5 * edge);
        let voxel = |k: usize, side: f64| ((middle[k] + side * reach[k]) * part.query.per_metre).floor() as i32;
        Self {
            part,
            raster: BoxRaster::new(&part.t_map_submap.rotation.to_rotation_matrix()),
            corner,
            cell: grid.cell,
            low: std::array::from_fn(|k| voxel(k, -1.0)),
            end: std::array::from_fn(|k| voxel(k, 1.0) + 1),
            occupied: Vec::new(),
            unknown: Vec::new(),
        }
    }

    /// Collects all voxels around the tile that are not free.
    fn collect(&mut self) {
        let tree = self.part.query.field.tree();
        let corner = block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT);
        let edge = (BLOCK_EDGE as i32) << tree.root_level();
        self.add_outside(corner, edge);
        self.visit(tree.root(), corner, tree.root_level());
    }

    /// Adds the unknown space outside of the root cube: a box on each side on which the tile extends beyond it.
    fn add_outside(&mut self, corner: [i32; 3], edge: i32) {
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

    fn visit(&mut self, octant: &Octant<Summary>, corner: [i32; 3], level: u32) {
        let edge = (BLOCK_EDGE << level) as i32;
        let summary = octant.payload;
        let is_outside = (0..3).any(|k| corner[k] >= self.end[k] || corner[k] + edge <= self.low[k]);
        if is_outside || (summary.observed && summary.max < 0) {
            return;
        }
        if octant.link == NONE || summary.max == UNKNOWN {
            self.push(state_of(if octant.link == NONE { summary.value } else { UNKNOWN }), corner, [edge; 3]);
        } else if level == 0 {
            self.visit_block(octant.link, corner);
        } else {
            for (i, child) in self.part.query.field.tree().siblings(octant.link).iter().enumerate() {
                self.visit(child, std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 }), level - 1);
            }
        }
    }

    /// Adds a block's voxels near the tile, combined into few boxes.
    fn visit_block(&mut self, id: u32, corner: [i32; 3]) {
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

    /// Adds a box, given by first corner and edges in finest voxels of the submap.
    fn push(&mut self, state: State, low: [i32; 3], size: [i32; 3]) {
        // Clipped to the tile, so that single precision is sufficient.
        let first: [i32; 3] = std::array::from_fn(|k| low[k].max(self.low[k]));
        let end: [i32; 3] = std::array::from_fn(|k| (low[k] + size[k]).min(self.end[k]));
        let voxel = self.part.query.voxel;
        let middle = moved(&self.part.t_map_submap, std::array::from_fn(|k| 0.5 * (f64::from(first[k]) + f64::from(end[k])) * voxel));
        let rotated = RotatedBox {
            centre: std::array::from_fn(|k| ((middle[k] - self.corner[k]) / self.cell) as f32),
            half: std::array::from_fn(|k| (0.5 * f64::from(end[k] - first[k]) * voxel / self.cell) as f32),
        };
        if state == State::Occupied { &mut self.occupied } else { &mut self.unknown }.push(rotated);
    }

    fn fill(&self, boxes: &[RotatedBox], within: &TileMask, mask: &mut TileMask) {
        boxes.iter().for_each(|rotated| self.raster.fill(rotated, within, mask));
    }
}

/// Divides a block's mask (a word for each z, bit x + 8 y) into few boxes, given by first corner and edges. Clears the mask.
fn boxes(mask: &mut [u64; BLOCK_EDGE], mut push: impl FnMut([usize; 3], [usize; 3])) {
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
            push([x, y, z], [along, across, up]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn boxes_contain_every_bit_once(mut mask in prop::array::uniform8(any::<u64>()), other in prop::array::uniform8(any::<u64>()), dense in any::<bool>()) {
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
