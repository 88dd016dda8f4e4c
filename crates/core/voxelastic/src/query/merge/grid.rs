//! The grid of a merged map: cubes, their submaps, and what becomes of them.

use super::tile_mask::TILE_LEVEL;
use crate::geometry::Aabb;
use crate::octree::{BLOCK_EDGE, MAX_BLOCK_COORD, block_coords, block_key};
use crate::query::AtlasQuery;
use crate::query::atlas::PlacedField;
use crate::query::shape::moved;

/// Values of merged cells: states only.
pub(super) const FREE: i8 = -1;
pub(super) const OCCUPIED: i8 = 1;

/// An octant or block of the merged map.
pub(super) enum MergedItem {
    /// An octant with one value.
    Uniform { key: u64, level: u32, value: i8 },
    /// A block of cells.
    Cells { key: u64, values: Box<[i8; BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE]> },
}

/// A cube of the merged map, with the submaps whose bounds it overlaps.
#[derive(Clone)]
pub(super) struct Node<'a, 'b> {
    pub key: u64,
    pub level: u32,
    pub parts: Vec<&'a PlacedField<'b>>,
}

/// The grid of cells, and the part of it to merge.
pub(super) struct Grid {
    /// Edge of a cell, metres.
    pub cell: f64,
    /// Bounds of the part to merge, metres in the map frame.
    low: [f64; 3],
    high: [f64; 3],
    /// Key of a block in the root cube.
    first: u64,
    pub root_level: u32,
}

impl Grid {
    /// None if there is nothing to merge.
    pub fn new(query: &AtlasQuery<'_>, cell: f32, within: Option<Aabb>) -> Option<Self> {
        let cell = f64::from(cell);
        let mut bounds = query.bounds();
        if let Some(wanted) = within {
            bounds.min = std::array::from_fn(|k| bounds.min[k].max(wanted.min[k]));
            bounds.max = std::array::from_fn(|k| bounds.max[k].min(wanted.max[k]));
        }
        let (low, high) = (bounds.min.map(f64::from), bounds.max.map(f64::from));
        // False for NaN.
        let is_box = (0..3).all(|k| low[k] <= high[k]);
        if query.is_empty() || !(cell > 0.0 && is_box) {
            return None;
        }
        let limit = f64::from(MAX_BLOCK_COORD);
        let [first, last] = [low, high].map(|p| p.map(|c| (c / (cell * BLOCK_EDGE as f64)).floor()));
        if first.iter().chain(&last).any(|c| c.abs() > limit) {
            return None;
        }
        let [first, last] = [first, last].map(|c| block_key(c.map(|c| c as i32)));
        let root_level = ((u64::BITS - (first ^ last).leading_zeros()).div_ceil(3)).max(TILE_LEVEL + 1);
        Some(Self { cell, low, high, first, root_level })
    }

    /// Key of the root cube.
    pub fn root_key(&self) -> u64 {
        self.first >> (3 * self.root_level) << (3 * self.root_level)
    }

    /// First corner of a cube and its edge, metres.
    pub fn cube(&self, key: u64, level: u32) -> ([f64; 3], f64) {
        let block = self.cell * BLOCK_EDGE as f64;
        (block_coords(key).map(|c| f64::from(c) * block), block * f64::from(1u32 << level))
    }

    /// The children of a node within the bounds that overlap the bounds of some submap.
    pub fn split<'a, 'b>(&self, node: &Node<'a, 'b>) -> Vec<Node<'a, 'b>> {
        let level = node.level - 1;
        let mut children = Vec::with_capacity(8);
        for i in 0..8u64 {
            let key = node.key | i << (3 * level);
            let (corner, edge) = self.cube(key, level);
            if (0..3).any(|k| corner[k] > self.high[k] || corner[k] + edge < self.low[k]) {
                continue;
            }
            let (middle, radius) = (corner.map(|c| c + 0.5 * edge), 0.5 * edge * 3f64.sqrt());
            let reaches = |part: &&PlacedField<'_>| {
                let p = moved(&part.t_submap_map, middle);
                part.reaches(p.map(|c| c - radius), p.map(|c| c + radius))
            };
            let parts: Vec<&PlacedField<'_>> = node.parts.iter().copied().filter(reaches).collect();
            if !parts.is_empty() {
                children.push(Node { key, level, parts });
            }
        }
        children
    }
}
