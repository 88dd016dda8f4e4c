//! The smallest cubes of the grid in which the centre of an occupied finest voxel lies.

use super::super::atlas::PlacedField;
use super::grid::{Region, Resampler};
use crate::field::occupancy::BlockBox;
use crate::geometry::morton;
use crate::octree::{BLOCK_SHIFT, NONE, voxel_coords};

impl Resampler {
    /// Morton key and largest value of each such smallest cube of a region, sorted by key.
    pub(super) fn occupied_cubes(&self, region: &Region<'_, '_>) -> Vec<(u64, i8)> {
        let mut all = Vec::new();
        region.submaps.iter().for_each(|submap| self.add_occupied(region, submap, &mut all));
        all.sort_unstable();
        // Of equal keys the last has the largest value.
        all.dedup_by(|later, kept| {
            let is_same = later.0 == kept.0;
            kept.1 = if is_same { later.1 } else { kept.1 };
            is_same
        });
        all
    }

    fn add_occupied(&self, region: &Region<'_, '_>, submap: &PlacedField<'_>, all: &mut Vec<(u64, i8)>) {
        let field = submap.query.field;
        let grid = self.grid_of(region, submap);
        let edge = f64::from(1u32 << region.level);
        let [low, high] = grid.bounds([edge; 3]);
        let t_grid_field = grid.inverse();
        let first = morton::encode(region.corner);
        let mut add = |corner: [i32; 3], edge_log2: u32, value: i8| {
            let last = corner.map(|c| c + ((1 << edge_log2) - 1));
            let range = |k: usize| corner[k].max(low[k])..=last[k].min(high[k]);
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let p = t_grid_field.apply([x, y, z].map(|c| f64::from(c) + 0.5));
                        if p.iter().all(|c| (0.0..edge).contains(c)) {
                            all.push((first | morton::encode(p.map(|c| c as u32)), value));
                        }
                    }
                }
            }
        };
        BlockBox::of_voxels(low, high).visit_leaves(field, &mut |summary| summary.max > 0, &mut |leaf| {
            let corner = leaf.corner.map(|c| c << BLOCK_SHIFT);
            if leaf.octant.link == NONE {
                add(corner, leaf.level + BLOCK_SHIFT, leaf.octant.payload.value);
                return false;
            }
            let block = field.block(leaf.octant.link);
            let scale = usize::from(block.scale);
            for (i, &value) in field.values(block).iter().enumerate().filter(|(_, v)| **v > 0) {
                let c = voxel_coords(i, scale);
                add(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), block.scale.into(), value);
            }
            false
        });
    }
}
