//! Boundary faces between two classes of voxels of any size: around occupied space, around free space, and the frontier to the unknown.
//!
//! Where voxels of different sizes are adjacent, the smaller one generates the face, so that every part of the boundary is generated
//! exactly once and at the finest stored resolution.

use super::field::OccupancyField;
use super::value::{State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, NONE, Octant, block_coords, block_key, edge_at, voxel_index};
use rayon::prelude::*;

/// Which boundary: the two classes of voxels on either side. The normal of a face points from the first to the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Boundary {
    /// From occupied voxels to all others.
    Occupied,
    /// From all other voxels to free ones.
    Free,
    /// From unknown voxels to free ones.
    Frontier,
}

/// The side of a boundary that a voxel is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    First,
    Second,
    Neither,
}

impl Boundary {
    #[inline(always)]
    fn side(self, value: i8) -> Side {
        match (self, state_of(value)) {
            (Self::Occupied, State::Occupied) | (Self::Free, State::Occupied | State::Unknown) | (Self::Frontier, State::Unknown) => Side::First,
            (Self::Occupied, _) | (Self::Free | Self::Frontier, State::Free) => Side::Second,
            (Self::Frontier, State::Occupied) => Side::Neither,
        }
    }
}

/// A rectangle of a boundary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Face {
    /// Corner with the smallest coordinates, finest voxels, submap frame.
    pub low: [i32; 3],
    /// Axis of the normal, 0 to 2.
    pub axis: usize,
    /// Whether the normal points in the positive direction of the axis.
    pub positive: bool,
    /// Edge lengths along the next two axes (cyclically), finest voxels.
    pub span: [i32; 2],
    /// log2 of the edge of the smaller adjacent voxel in finest voxels, at most 3.
    pub scale: u8,
}

/// All faces of `boundary`, in Morton order of the octants that generate them. With `merged`, adjacent faces in a plane of a block are
/// merged into rectangles; otherwise there is one face per voxel.
pub(crate) fn faces(field: &OccupancyField, boundary: Boundary, merged: bool) -> Vec<Face> {
    const OCTANTS_PER_TASK: usize = 256;
    let mut leaves = Vec::new();
    field.tree().for_each(|key, level, octant| {
        if level == 0 || octant.link == NONE {
            leaves.push((key, level, *octant));
        }
    });
    let search = FaceSearch { field, boundary, merged };
    let parts: Vec<Vec<Face>> = leaves
        .par_chunks(OCTANTS_PER_TASK)
        .map(|leaves| {
            let mut faces = Vec::new();
            for &(key, level, octant) in leaves {
                if octant.link == NONE {
                    search.add_octant(key, level, &octant, &mut faces);
                } else {
                    search.add_block(key, octant.link, &mut faces);
                }
            }
            faces
        })
        .collect();
    parts.concat()
}

/// The neighbour of a block or octant across one of its faces.
enum Neighbour<'a> {
    /// A uniform octant, which is `larger` or of equal size.
    Uniform { value: i8, larger: bool },
    /// A block of voxels at a scale.
    Block { values: &'a [i8], scale: usize },
    /// Smaller octants, which generate the faces themselves.
    Finer,
}

struct FaceSearch<'a> {
    field: &'a OccupancyField,
    boundary: Boundary,
    merged: bool,
}

/// One of the six axis-aligned directions.
#[derive(Clone, Copy)]
struct Direction {
    axis: usize,
    positive: bool,
}

const DIRECTIONS: [Direction; 6] = {
    let mut all = [Direction { axis: 0, positive: false }; 6];
    let mut i = 0;
    while i < 6 {
        all[i] = Direction { axis: i / 2, positive: i % 2 == 1 };
        i += 1;
    }
    all
};

/// Bit set of the faces in a plane of voxels: bit u + 8 v.
type Plane = u64;

impl FaceSearch<'_> {
    /// The neighbour in `direction` of the octant of `level` at block `corner`.
    fn neighbour(&self, corner: [i32; 3], level: u32, direction: Direction) -> Neighbour<'_> {
        const OUTSIDE: Neighbour<'_> = Neighbour::Uniform { value: UNKNOWN, larger: true };
        let mut c = corner;
        c[direction.axis] += if direction.positive { 1 << level } else { -1 };
        if c[direction.axis].abs() > MAX_BLOCK_COORD {
            return OUTSIDE;
        }
        let Some((found, octant)) = self.field.tree().find_at_least(block_key(c), level) else { return OUTSIDE };
        if octant.link == NONE {
            Neighbour::Uniform { value: octant.payload.value, larger: found > level }
        } else if level == 0 {
            let block = self.field.block(octant.link);
            Neighbour::Block { values: self.field.values(block), scale: usize::from(block.scale) }
        } else {
            Neighbour::Finer
        }
    }

    /// Whether a voxel on side `own` generates a face to a neighbour on side `other`, and if so, whether the face's normal points towards the
    /// neighbour.
    #[inline(always)]
    fn outward(own: Side, other: Side, larger: bool) -> Option<bool> {
        match (own, other) {
            (Side::First, Side::Second) => Some(true),
            // Of voxels of equal size the one on the first side generates the face.
            (Side::Second, Side::First) if larger => Some(false),
            _ => None,
        }
    }

    fn add_octant(&self, key: u64, level: u32, octant: &Octant<Summary>, faces: &mut Vec<Face>) {
        let own = self.boundary.side(octant.payload.value);
        if own == Side::Neither {
            return;
        }
        let corner = block_coords(key);
        let edge = (BLOCK_EDGE << level) as i32;
        for direction in DIRECTIONS {
            // A block next to a uniform octant of block size has smaller voxels and generates the faces itself.
            let Neighbour::Uniform { value, larger } = self.neighbour(corner, level, direction) else { continue };
            if let Some(out) = Self::outward(own, self.boundary.side(value), larger) {
                let mut low = corner.map(|c| c << BLOCK_SHIFT);
                low[direction.axis] += if direction.positive { edge } else { 0 };
                faces.push(Face { low, axis: direction.axis, positive: direction.positive == out, span: [edge; 2], scale: 3 });
            }
        }
    }

    fn add_block(&self, key: u64, id: u32, faces: &mut Vec<Face>) {
        let block = self.field.block(id);
        let (values, scale) = (self.field.values(block), usize::from(block.scale));
        let corner = block_coords(key);
        let n = edge_at(scale);
        for direction in DIRECTIONS {
            let neighbour = self.neighbour(corner, 0, direction);
            for plane in 0..n {
                let (mut out, mut inward): (Plane, Plane) = (0, 0);
                for v in 0..n {
                    for u in 0..n {
                        let c = unfold(direction.axis, plane, u, v);
                        let own = self.boundary.side(values[voxel_index(c, scale)]);
                        let Some((other, larger)) = self.adjacent(values, scale, c, direction, &neighbour) else { continue };
                        match Self::outward(own, other, larger) {
                            Some(true) => out |= 1 << (u + 8 * v),
                            Some(false) => inward |= 1 << (u + 8 * v),
                            None => {}
                        }
                    }
                }
                let layer = Layer { corner, direction, plane, scale };
                self.emit(out, &layer, true, faces);
                self.emit(inward, &layer, false, faces);
            }
        }
    }

    /// Side of the voxel adjacent to voxel `c` of a block, and whether it is larger; none if the adjacent voxels are smaller. `neighbour` is
    /// the neighbour of the block.
    #[inline(always)]
    fn adjacent(&self, values: &[i8], scale: usize, c: [usize; 3], direction: Direction, neighbour: &Neighbour<'_>) -> Option<(Side, bool)> {
        let (axis, n) = (direction.axis, edge_at(scale));
        let mut next = c;
        next[axis] = if direction.positive { c[axis] + 1 } else { c[axis].wrapping_sub(1) };
        if next[axis] < n {
            return Some((self.boundary.side(values[voxel_index(next, scale)]), false));
        }
        next[axis] = if direction.positive { 0 } else { n - 1 };
        match *neighbour {
            Neighbour::Uniform { value, larger } => Some((self.boundary.side(value), larger || scale < 3)),
            Neighbour::Block { values, scale: other } if other >= scale => {
                let c = next.map(|v| v >> (other - scale));
                Some((self.boundary.side(values[voxel_index(c, other)]), other > scale))
            }
            _ => None,
        }
    }

    /// Converts the bits of a plane to faces, merged into rectangles if requested.
    fn emit(&self, mut bits: Plane, layer: &Layer, out: bool, faces: &mut Vec<Face>) {
        while bits != 0 {
            let first = bits.trailing_zeros() as usize;
            let (u, v) = (first % 8, first / 8);
            let (mut width, mut height) = (1, 1);
            if self.merged {
                width = (bits >> first & (0xff >> u)).trailing_ones() as usize;
                let row = 0xff_u64 >> (8 - width);
                while v + height < 8 && bits >> (first + 8 * height) & row == row {
                    height += 1;
                }
            }
            let row = (0xff_u64 >> (8 - width)) << u;
            (v..v + height).for_each(|v| bits &= !(row << (8 * v)));
            faces.push(layer.face([u, v], [width, height], out));
        }
    }
}

/// A plane of voxel faces in a block.
struct Layer {
    corner: [i32; 3],
    direction: Direction,
    plane: usize,
    scale: usize,
}

impl Layer {
    fn face(&self, [u, v]: [usize; 2], [width, height]: [usize; 2], out: bool) -> Face {
        let axis = self.direction.axis;
        let plane = self.plane + usize::from(self.direction.positive);
        let local = unfold(axis, plane, u, v);
        let low = std::array::from_fn(|k| (self.corner[k] << BLOCK_SHIFT) + (local[k] << self.scale) as i32);
        let span = [width, height].map(|n| (n << self.scale) as i32);
        Face { low, axis, positive: self.direction.positive == out, span, scale: self.scale as u8 }
    }
}

/// Coordinates of a voxel: `plane` along `axis`, `u` and `v` along the next two axes (cyclically).
#[inline(always)]
fn unfold(axis: usize, plane: usize, u: usize, v: usize) -> [usize; 3] {
    let mut c = [0; 3];
    (c[axis], c[(axis + 1) % 3], c[(axis + 2) % 3]) = (plane, u, v);
    c
}
