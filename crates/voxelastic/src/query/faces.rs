//! Faces between two kinds of voxels, whatever their sizes: the skin of occupied space, of free space, of the unknown.
//!
//! Where voxels of different sizes meet, the smaller one names the face, so that every piece of the boundary is named
//! exactly once and at the finest size at which it is known.

use super::FieldQuery;
use crate::field::occupancy::{OccupancyField, State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, NONE, Octant, block_coords, block_key, edge_at, voxel_index};
use rayon::prelude::*;

/// Between what is it? Faces look from the first kind to the second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Boundary {
    /// From occupied voxels to all others.
    Occupied,
    /// From all other voxels to free ones.
    Free,
    /// From unknown voxels to free ones.
    Frontier,
}

/// Which side of a boundary a voxel is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Solid,
    Air,
    Neither,
}

impl Boundary {
    #[inline(always)]
    fn side(self, value: i8) -> Side {
        match (self, state_of(value)) {
            (Self::Occupied, State::Occupied) | (Self::Free, State::Occupied | State::Unknown) | (Self::Frontier, State::Unknown) => Side::Solid,
            (Self::Occupied, _) | (Self::Free | Self::Frontier, State::Free) => Side::Air,
            (Self::Frontier, State::Occupied) => Side::Neither,
        }
    }
}

/// A rectangle of a boundary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Face {
    /// Smallest corner, finest voxels of the submap frame.
    pub low: [i32; 3],
    /// Axis of the normal.
    pub axis: usize,
    /// Whether the normal, from the first kind of voxels to the second, points along the axis and not against it.
    pub positive: bool,
    /// Edge lengths along the next axis and the one after, finest voxels.
    pub span: [i32; 2],
    /// log2 of the smaller voxel's edge, at most 3.
    pub scale: u8,
}

/// All faces of `boundary`, in Morton order of the octants that name them. `merged`: neighbours within a block and plane
/// become rectangles; otherwise there is a face for each voxel.
pub(crate) fn faces(field: &OccupancyField, boundary: Boundary, merged: bool) -> Vec<Face> {
    const OCTANTS_PER_TASK: usize = 256;
    let mut leaves = Vec::new();
    field.tree().for_each(|key, level, octant| {
        if level == 0 || octant.link == NONE {
            leaves.push((key, level, *octant));
        }
    });
    let search = Search { query: FieldQuery::new(field, 1.0), boundary, merged };
    let parts: Vec<Vec<Face>> = leaves
        .par_chunks(OCTANTS_PER_TASK)
        .map(|leaves| {
            let mut faces = Vec::new();
            for &(key, level, octant) in leaves {
                if octant.link == NONE {
                    search.around_octant(key, level, &octant, &mut faces);
                } else {
                    search.in_block(key, octant.link, &mut faces);
                }
            }
            faces
        })
        .collect();
    parts.concat()
}

/// What lies next to a block or octant of some size.
enum Beside<'a> {
    /// One value, in an octant that is `larger` or of equal size.
    Uniform { value: i8, larger: bool },
    /// A block of voxels at a scale.
    Block { values: &'a [i8], scale: usize },
    /// Smaller octants: they name the faces.
    Finer,
}

struct Search<'a> {
    query: FieldQuery<'a>,
    boundary: Boundary,
    merged: bool,
}

/// A direction along an axis.
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

/// Faces of a plane of voxels, a bit each: bit u + 8 v.
type Plane = u64;

impl Search<'_> {
    /// What lies beyond the face of the octant of `level` at block `corner`.
    fn beside(&self, corner: [i32; 3], level: u32, direction: Direction) -> Beside<'_> {
        const OUTSIDE: Beside<'_> = Beside::Uniform { value: UNKNOWN, larger: true };
        let mut c = corner;
        c[direction.axis] += if direction.positive { 1 << level } else { -1 };
        if c[direction.axis].abs() > MAX_BLOCK_COORD {
            return OUTSIDE;
        }
        let Some((found, octant)) = self.query.octant(block_key(c), level) else { return OUTSIDE };
        let octant: Octant<Summary> = octant;
        if octant.link == NONE {
            Beside::Uniform { value: octant.payload.value, larger: found > level }
        } else if level == 0 {
            let block = self.query.field.block(octant.link);
            Beside::Block { values: self.query.field.values(block), scale: usize::from(block.scale) }
        } else {
            Beside::Finer
        }
    }

    /// Whether a face that a voxel of side `own` may name lies between it and what is beside, and whether it looks out.
    #[inline(always)]
    fn outward(own: Side, other: Side, larger: bool) -> Option<bool> {
        match (own, other) {
            (Side::Solid, Side::Air) => Some(true),
            // Among equals the first kind names the face.
            (Side::Air, Side::Solid) if larger => Some(false),
            _ => None,
        }
    }

    fn around_octant(&self, key: u64, level: u32, octant: &Octant<Summary>, faces: &mut Vec<Face>) {
        let own = self.boundary.side(octant.payload.value);
        if own == Side::Neither {
            return;
        }
        let corner = block_coords(key);
        let edge = (BLOCK_EDGE << level) as i32;
        for direction in DIRECTIONS {
            // A block beside a uniform block-sized octant has smaller voxels, or one that would make it uniform.
            let Beside::Uniform { value, larger } = self.beside(corner, level, direction) else { continue };
            if let Some(out) = Self::outward(own, self.boundary.side(value), larger) {
                let mut low = corner.map(|c| c << BLOCK_SHIFT);
                low[direction.axis] += if direction.positive { edge } else { 0 };
                faces.push(Face { low, axis: direction.axis, positive: direction.positive == out, span: [edge; 2], scale: 3 });
            }
        }
    }

    fn in_block(&self, key: u64, id: u32, faces: &mut Vec<Face>) {
        let block = self.query.field.block(id);
        let (values, scale) = (self.query.field.values(block), usize::from(block.scale));
        let corner = block_coords(key);
        let n = edge_at(scale);
        for direction in DIRECTIONS {
            let beside = self.beside(corner, 0, direction);
            for plane in 0..n {
                let (mut out, mut inward): (Plane, Plane) = (0, 0);
                for v in 0..n {
                    for u in 0..n {
                        let c = unfold(direction.axis, plane, u, v);
                        let own = self.boundary.side(values[voxel_index(c, scale)]);
                        let Some((other, larger)) = self.neighbour(values, scale, c, direction, &beside) else { continue };
                        match Self::outward(own, other, larger) {
                            Some(true) => out |= 1 << (u + 8 * v),
                            Some(false) => inward |= 1 << (u + 8 * v),
                            None => {}
                        }
                    }
                }
                let at = Sheet { corner, direction, plane, scale };
                self.emit(out, &at, true, faces);
                self.emit(inward, &at, false, faces);
            }
        }
    }

    /// Side of the voxel next to voxel `c` of a block, and whether it is larger; none when smaller ones are there.
    #[inline(always)]
    fn neighbour(&self, values: &[i8], scale: usize, c: [usize; 3], direction: Direction, beside: &Beside<'_>) -> Option<(Side, bool)> {
        let (axis, n) = (direction.axis, edge_at(scale));
        let mut next = c;
        next[axis] = if direction.positive { c[axis] + 1 } else { c[axis].wrapping_sub(1) };
        if next[axis] < n {
            return Some((self.boundary.side(values[voxel_index(next, scale)]), false));
        }
        next[axis] = if direction.positive { 0 } else { n - 1 };
        match *beside {
            Beside::Uniform { value, larger } => Some((self.boundary.side(value), larger || scale < 3)),
            Beside::Block { values, scale: other } if other >= scale => {
                let c = next.map(|v| v >> (other - scale));
                Some((self.boundary.side(values[voxel_index(c, other)]), other > scale))
            }
            _ => None,
        }
    }

    /// Turns the bits of a plane into faces, as rectangles if they are to be merged.
    fn emit(&self, mut bits: Plane, at: &Sheet, out: bool, faces: &mut Vec<Face>) {
        while bits != 0 {
            let first = bits.trailing_zeros() as usize;
            let (u, v) = (first % 8, first / 8);
            let (mut wide, mut tall) = (1, 1);
            if self.merged {
                wide = (bits >> first & (0xff >> u)).trailing_ones() as usize;
                let row = 0xff_u64 >> (8 - wide);
                while v + tall < 8 && bits >> (first + 8 * tall) & row == row {
                    tall += 1;
                }
            }
            let row = (0xff_u64 >> (8 - wide)) << u;
            (v..v + tall).for_each(|v| bits &= !(row << (8 * v)));
            faces.push(at.face([u, v], [wide, tall], out));
        }
    }
}

/// A plane of voxel faces in a block.
struct Sheet {
    corner: [i32; 3],
    direction: Direction,
    plane: usize,
    scale: usize,
}

impl Sheet {
    fn face(&self, [u, v]: [usize; 2], [wide, tall]: [usize; 2], out: bool) -> Face {
        let axis = self.direction.axis;
        let plane = self.plane + usize::from(self.direction.positive);
        let local = unfold(axis, plane, u, v);
        let low = std::array::from_fn(|k| (self.corner[k] << BLOCK_SHIFT) + (local[k] << self.scale) as i32);
        let span = [wide, tall].map(|n| (n << self.scale) as i32);
        Face { low, axis, positive: self.direction.positive == out, span, scale: self.scale as u8 }
    }
}

/// Coordinates from those along an axis, the next one and the one after.
#[inline(always)]
fn unfold(axis: usize, plane: usize, u: usize, v: usize) -> [usize; 3] {
    let mut c = [0; 3];
    (c[axis], c[(axis + 1) % 3], c[(axis + 2) % 3]) = (plane, u, v);
    c
}
