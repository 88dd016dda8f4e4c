//! Merging an atlas into one field.

use super::grid::{FREE, Grid, MergedItem, Node};
use super::tile::rasterise_tile;
use super::tile_mask::TILE_LEVEL;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::field::occupancy::{OccupancyField, State, Summary};
use crate::geometry::{Aabb, Pose};
use crate::octree::{Cursor, Octree};
use crate::query::shape::OrientedBox;
use crate::query::shape_sdf::BoxSolid;
use crate::query::{AtlasQuery, FieldQuery};
use rayon::prelude::*;

/// Resolution and bounds of a merged map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MergeOptions {
    /// Edge of a cell, metres: at most the map's finest voxel. The grid contains the origin.
    pub cell: f32,
    /// Part of the map to merge, map frame; none for all of it. Everything outside is unknown.
    pub bounds: Option<Aabb>,
}

/// A map merged into one field. It owns its data: the atlas may change or be dropped.
#[derive(Clone, Debug)]
pub struct MergedMap {
    field: OccupancyField,
    cell: f32,
}

impl MergedMap {
    /// Queries on it. Points are in the map frame, metres; the finest voxels are cells.
    pub fn query(&self) -> FieldQuery<'_> {
        FieldQuery::new(&self.field, self.cell)
    }

    /// The field: its values distinguish [`State`]s only.
    pub fn field(&self) -> &OccupancyField {
        &self.field
    }

    /// Edge of a cell, metres.
    pub fn cell(&self) -> f32 {
        self.cell
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        self.field.bytes()
    }
}

impl AtlasQuery<'_> {
    /// The map as one field.
    ///
    /// A cell is occupied if it overlaps an occupied voxel of any submap, otherwise free if all voxels of some submap that it overlaps are
    /// free, otherwise unknown; overlaps of less than a thousandth of a cell do not count. So what is free in the merged map is free,
    /// obstacles and unknown space grow by less than a cell, and distances to them shrink by at most a cell's diagonal. A single submap that
    /// is not rotated against the map, with cells of its voxel size, stays as it is.
    ///
    /// If the cell size is not a positive length, or so small that the map is more than 2^24 cells long, the result is empty.
    pub fn merge(&self, options: &MergeOptions) -> MergedMap {
        let mut merged = MergedMap { field: OccupancyField::default(), cell: options.cell };
        let Some(grid) = Grid::new(self, options.cell, options.bounds) else { return merged };
        let mut tree = Octree::with_root(grid.root_key(), grid.root_level, Summary::default());
        tree.root_mut().link = tree.add_group(Summary::default());
        merged.field.tree = tree;
        let mut nodes = vec![Node { key: grid.root_key(), level: grid.root_level, parts: self.parts.iter().collect() }];
        // Enough nodes for any number of threads; how they are divided depends on the map alone.
        while nodes.len() < 512 && nodes.iter().any(|node| node.level > TILE_LEVEL) {
            nodes = nodes.iter().flat_map(|node| if node.level > TILE_LEVEL { grid.split(node) } else { vec![node.clone()] }).collect();
        }
        let items: Vec<Vec<MergedItem>> = nodes
            .par_iter()
            .map(|node| {
                let mut items = Vec::new();
                merge_cube(&grid, node, &mut items);
                items
            })
            .collect();
        insert_items(&mut merged.field, items.into_iter().flatten());
        merged
    }
}

/// Inserts items, in Morton order, into an empty field.
fn insert_items(field: &mut OccupancyField, items: impl Iterator<Item = MergedItem>) {
    let mut cursor = Cursor::new(&field.tree);
    let mut changed = ChangedOctants::default();
    for item in items {
        let (key, level) = match item {
            MergedItem::Uniform { key, level, value } => {
                let (group, child) = cursor.find_or_create_at(&mut field.tree, key, level);
                field.tree.siblings_mut(group)[child].payload = Summary::uniform(value);
                (key, level)
            }
            MergedItem::Cells { key, values } => {
                let id = field.find_or_create(&mut cursor, key, 0);
                let slot = field.block(id).slot;
                field.voxels.get_mut(0, slot).copy_from_slice(&*values);
                if let Some(octant) = field.tree.octant_mut(key, 0) {
                    octant.payload = Summary::of(values.iter().map(|&value| Summary::uniform(value)));
                }
                (key, 0)
            }
        };
        changed.add(key, level);
    }
    changed.propagate_unlogged(field);
}

/// Merges a cube: appends its items in Morton order.
fn merge_cube(grid: &Grid, node: &Node<'_, '_>, items: &mut Vec<MergedItem>) {
    match uniform_state(grid, node) {
        Some(State::Unknown) => {}
        Some(State::Free) => items.push(MergedItem::Uniform { key: node.key, level: node.level, value: FREE }),
        _ if node.level == TILE_LEVEL => rasterise_tile(grid, node, items),
        _ => grid.split(node).iter().for_each(|child| merge_cube(grid, child, items)),
    }
}

/// Free or unknown if all of a cube is, as far as the octants touching it determine that.
fn uniform_state(grid: &Grid, node: &Node<'_, '_>) -> Option<State> {
    let (corner, edge) = grid.cube(node.key, node.level);
    let middle = corner.map(|c| c + 0.5 * edge);
    let t_map_cube = Pose::translation(middle[0], middle[1], middle[2]);
    let (mut is_known, mut has_free) = (false, false);
    for part in &node.parts {
        let cube = OrientedBox { t_frame_box: part.t_submap_map * t_map_cube, half: [0.5 * edge; 3] };
        let states = part.query.states_in(&BoxSolid::new(&cube, part.query.per_metre));
        if states.occupied {
            return None;
        }
        has_free |= states.free;
        is_known |= !states.unknown;
    }
    if is_known { Some(State::Free) } else { (!has_free).then_some(State::Unknown) }
}
