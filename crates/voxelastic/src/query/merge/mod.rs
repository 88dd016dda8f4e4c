//! The whole map as one field of the map frame, for those who ask a lot: a merged map answers as fast as a single submap does.
//!
//! An [`AtlasQuery`] has to ask every submap around, and to find out which of them complete each other. Merging does that once for
//! each cell of a grid. From the root down, cubes in which every submap says the same need no closer look; the rest is drawn, tile by
//! tile (`tile.rs`), with the voxels of each submap as turned boxes (`raster.rs`).

mod raster;
mod tile;

use super::atlas::Part;
use super::shape::{OrientedBox, moved};
use super::solid::{Block, Solid};
use super::{AtlasQuery, FieldQuery};
use crate::field::occupancy::{OccupancyField, State, Summary, UNKNOWN, state_of};
use crate::geometry::{Aabb, Pose};
use crate::integrate::occupancy::propagate::Touched;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, MAX_BLOCK_COORD, NONE, Octant, Octree, block_coords, block_key, voxel_coords};
use rayon::prelude::*;

/// Values of merged cells: states only.
const FREE: i8 = -1;
const OCCUPIED: i8 = 1;

/// How to merge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merging {
    /// Edge of a cell, metres: the map's finest voxel, or a part of it. Cells start at multiples of it.
    pub cell: f32,
    /// What to merge, map frame; none for all that is known. Everything outside stays unknown.
    pub bounds: Option<Aabb>,
}

/// A map merged into one field. It holds what it knows by itself: the map it was made from may change or go.
#[derive(Clone, Debug)]
pub struct MergedMap {
    field: OccupancyField,
    cell: f32,
}

impl MergedMap {
    /// What can be asked of it. Points are in the map frame, metres; the finest voxels are cells.
    pub fn query(&self) -> FieldQuery<'_> {
        FieldQuery::new(&self.field, self.cell)
    }

    /// The field itself: values are those of [`State`]s only.
    pub fn field(&self) -> &OccupancyField {
        &self.field
    }

    /// Edge of a cell, metres.
    pub fn cell(&self) -> f32 {
        self.cell
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.field.bytes()
    }
}

impl AtlasQuery<'_> {
    /// The map as one field.
    ///
    /// A cell is occupied if it overlaps an occupied voxel of any submap, otherwise free if all voxels of some submap that it
    /// overlaps are, otherwise unknown; overlaps of less than a thousandth of a cell are none. So what the merged map calls free is free,
    /// obstacles and unknown space grow by less than a cell, and distances to them shrink by no more than a cell's diagonal. Where
    /// the only submap is not turned against the map and the cell is its voxel, nothing changes at all.
    ///
    /// A cell that is not a length, or so small that the map is more than 2^24 cells long, merges nothing.
    pub fn merge(&self, to: &Merging) -> MergedMap {
        let mut merged = MergedMap { field: OccupancyField::default(), cell: to.cell };
        let Some(task) = Task::new(self, to) else { return merged };
        let mut tree = Octree::with_root(task.root_key(), task.root_level, Summary::default());
        tree.root_mut().link = tree.add_group(Summary::default());
        merged.field.tree = tree;
        let mut nodes = vec![Node { key: task.root_key(), level: task.root_level, parts: self.parts.iter().collect() }];
        // Enough for any number of threads; where it is cut the map says, not the machine.
        while nodes.len() < 512 && nodes.iter().any(|node| node.level > tile::LEVEL) {
            nodes = nodes.iter().flat_map(|node| if node.level > tile::LEVEL { task.split(node) } else { vec![node.clone()] }).collect();
        }
        let pieces: Vec<Vec<Piece>> = nodes
            .par_iter()
            .map(|node| {
                let mut pieces = Vec::new();
                task.run(node, &mut pieces);
                pieces
            })
            .collect();
        put(&mut merged.field, pieces.into_iter().flatten());
        merged
    }
}

/// A part of the result.
enum Piece {
    /// An octant of one value.
    Uniform { key: u64, level: u32, value: i8 },
    /// A block of cells.
    Cells { key: u64, values: Box<[i8; BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE]> },
}

/// Puts the pieces, in Morton order, into an empty field.
fn put(field: &mut OccupancyField, pieces: impl Iterator<Item = Piece>) {
    let mut cursor = Cursor::new(&field.tree);
    let mut touched = Touched::default();
    for piece in pieces {
        let (key, level) = match piece {
            Piece::Uniform { key, level, value } => {
                let (group, place) = cursor.make_at(&mut field.tree, key, level);
                field.tree.siblings_mut(group)[place].payload = Summary::uniform(value);
                (key, level)
            }
            Piece::Cells { key, values } => {
                let id = field.make(&mut cursor, key, 0);
                let slot = field.block(id).slot;
                field.voxels.get_mut(0, slot).copy_from_slice(&*values);
                if let Some(octant) = field.tree.octant_mut(key, 0) {
                    octant.payload = Summary::of(values.iter().map(|&value| Summary::uniform(value)));
                }
                (key, 0)
            }
        };
        touched.add(key, level);
    }
    touched.propagate(field);
}

/// A cube of the merged map, with the submaps that may know something of it.
#[derive(Clone)]
struct Node<'a, 'b> {
    key: u64,
    level: u32,
    parts: Vec<&'a Part<'b>>,
}

struct Task {
    cell: f64,
    /// What to merge, metres in the map frame.
    low: [f64; 3],
    high: [f64; 3],
    /// Key of a block in the root cube.
    first: u64,
    root_level: u32,
}

/// What a submap knows of a cube, at a glance.
#[derive(Clone, Copy, Default)]
struct Glance {
    free: bool,
    unknown: bool,
    occupied: bool,
}

impl Glance {
    fn add(&mut self, value: i8) {
        match state_of(value) {
            State::Free => self.free = true,
            State::Unknown => self.unknown = true,
            State::Occupied => self.occupied = true,
        }
    }
}

impl Task {
    /// None when there is nothing to merge.
    fn new(query: &AtlasQuery<'_>, to: &Merging) -> Option<Self> {
        let cell = f64::from(to.cell);
        let mut bounds = query.bounds();
        if let Some(wanted) = to.bounds {
            bounds.min = std::array::from_fn(|k| bounds.min[k].max(wanted.min[k]));
            bounds.max = std::array::from_fn(|k| bounds.max[k].min(wanted.max[k]));
        }
        let (low, high) = (bounds.min.map(f64::from), bounds.max.map(f64::from));
        // Negated, so that what is no number ends here.
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
        let root_level = ((u64::BITS - (first ^ last).leading_zeros()).div_ceil(3)).max(tile::LEVEL + 1);
        Some(Self { cell, low, high, first, root_level })
    }

    fn root_key(&self) -> u64 {
        self.first >> (3 * self.root_level) << (3 * self.root_level)
    }

    /// Smallest corner of a node and its edge, metres.
    fn cube(&self, key: u64, level: u32) -> ([f64; 3], f64) {
        let block = self.cell * BLOCK_EDGE as f64;
        (block_coords(key).map(|c| f64::from(c) * block), block * f64::from(1u32 << level))
    }

    /// The children of a node within the bounds that some submap may know something of.
    fn split<'a, 'b>(&self, node: &Node<'a, 'b>) -> Vec<Node<'a, 'b>> {
        let level = node.level - 1;
        let mut children = Vec::with_capacity(8);
        for i in 0..8u64 {
            let key = node.key | i << (3 * level);
            let (corner, edge) = self.cube(key, level);
            if (0..3).any(|k| corner[k] > self.high[k] || corner[k] + edge < self.low[k]) {
                continue;
            }
            let (middle, radius) = (corner.map(|c| c + 0.5 * edge), 0.5 * edge * 3f64.sqrt());
            let reaches = |part: &&Part<'_>| {
                let p = moved(&part.t_submap_map, middle);
                part.reaches(p.map(|c| c - radius), p.map(|c| c + radius))
            };
            let parts: Vec<&Part<'_>> = node.parts.iter().copied().filter(reaches).collect();
            if !parts.is_empty() {
                children.push(Node { key, level, parts });
            }
        }
        children
    }

    fn run(&self, node: &Node<'_, '_>, pieces: &mut Vec<Piece>) {
        match self.state(node) {
            Some(State::Unknown) => {}
            Some(State::Free) => pieces.push(Piece::Uniform { key: node.key, level: node.level, value: FREE }),
            _ if node.level == tile::LEVEL => self.draw(node, pieces),
            _ => self.split(node).iter().for_each(|child| self.run(child, pieces)),
        }
    }

    /// Free or unknown, if all of a node is so and it can be told at a glance.
    fn state(&self, node: &Node<'_, '_>) -> Option<State> {
        let (corner, edge) = self.cube(node.key, node.level);
        let middle = corner.map(|c| c + 0.5 * edge);
        let t_map_cube = Pose::translation(middle[0], middle[1], middle[2]);
        let (mut is_known, mut has_free) = (false, false);
        for part in &node.parts {
            let cube = OrientedBox { t_frame_box: part.t_submap_map * t_map_cube, half: [0.5 * edge; 3] };
            let seen = part.query.glance(&Block::new(&cube, part.query.per_metre));
            if seen.occupied {
                return None;
            }
            has_free |= seen.free;
            is_known |= !seen.unknown;
        }
        if is_known { Some(State::Free) } else { (!has_free).then_some(State::Unknown) }
    }
}

impl FieldQuery<'_> {
    /// Which states there are among the leaves that the solid touches; no more are looked for when one is occupied.
    fn glance<S: Solid>(&self, solid: &S) -> Glance {
        let tree = self.field.tree();
        let corner = block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT);
        let edge = (BLOCK_EDGE as f32) * (1u32 << tree.root_level()) as f32;
        let (low, high) = solid.bounds();
        let is_inside = (0..3).all(|k| low[k] > corner[k] as f32 && high[k] < corner[k] as f32 + edge);
        let mut seen = Glance { unknown: !is_inside, ..Glance::default() };
        self.glance_at(tree.root(), corner, tree.root_level(), solid, &mut seen);
        seen
    }

    fn glance_at<S: Solid>(&self, octant: &Octant<Summary>, corner: [i32; 3], level: u32, solid: &S, seen: &mut Glance) {
        let summary = octant.payload;
        let is_free = summary.observed && summary.max < 0;
        let nothing_new = (is_free && seen.free) || (summary.max <= 0 && seen.free && seen.unknown);
        let edge = (BLOCK_EDGE << level) as i32;
        let meets = |low: [i32; 3], edge: i32| solid.meets(low.map(|c| c as f32), low.map(|c| (c + edge) as f32));
        if seen.occupied || nothing_new || !meets(corner, edge) {
            return;
        }
        if is_free || summary.max == UNKNOWN {
            seen.add(summary.max);
        } else if octant.link == NONE {
            seen.add(summary.value);
        } else if level == 0 {
            let block = self.field.block(octant.link);
            let scale = usize::from(block.scale);
            for (i, &value) in self.field.values(block).iter().enumerate() {
                let c = voxel_coords(i, scale);
                if meets(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), 1 << scale) {
                    seen.add(value);
                }
            }
        } else {
            for (i, child) in self.field.tree().siblings(octant.link).iter().enumerate() {
                let at = std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 });
                self.glance_at(child, at, level - 1, solid, seen);
            }
        }
    }
}
