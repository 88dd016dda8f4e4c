//! Collision checks of shapes: descends the octree from the smallest octant that contains the shape and skips octants whose maximum is free.

use super::field::{blocks, is_clear};
use super::shape::Shape;
use super::shape_sdf::Solid;
use super::{FieldQuery, UnknownAs};
use crate::field::occupancy::{OccupancyField, Summary};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, edge_at, voxel_coords};
use std::cell::Cell;

/// Calls `$body` with `$solid` bound to the shape in voxels, whatever its kind.
macro_rules! with_solid {
    ($shape:expr, $per_metre:expr, |$solid:ident| $body:expr) => {
        match $shape {
            Shape::Sphere(s) => {
                let $solid = &crate::query::shape_sdf::SphereSolid::new(s, $per_metre);
                $body
            }
            Shape::Capsule(c) => {
                let $solid = &crate::query::shape_sdf::CapsuleSolid::new(c, $per_metre);
                $body
            }
            Shape::Box(b) => {
                let $solid = &crate::query::shape_sdf::BoxSolid::new(b, $per_metre);
                $body
            }
        }
    };
}
pub(crate) use with_solid;

impl FieldQuery<'_> {
    /// Whether all of `shape` (submap frame) is free: whether all voxels that it touches, at the size at which the field holds them, are
    /// free. Space outside of the field is unknown.
    pub fn is_free(&self, shape: &Shape, unknown: UnknownAs) -> bool {
        shape.is_valid() && with_solid!(shape, self.per_metre, |solid| self.is_clear_of(solid, unknown))
    }

    /// As [`is_free`](Self::is_free), with the number of octants and blocks visited.
    pub fn is_free_with_stats(&self, shape: &Shape, unknown: UnknownAs) -> (bool, QueryStats) {
        let stats = Cell::new(QueryStats { octants: 0, blocks: 0, smallest: u32::MAX });
        let is_free = shape.is_valid()
            && with_solid!(shape, self.per_metre, |solid| match unknown {
                UnknownAs::Blocked => Check::<_, _, true>::new(self.field, solid, &stats).run(),
                UnknownAs::Free => Check::<_, _, false>::new(self.field, solid, &stats).run(),
            });
        (is_free, stats.get())
    }

    /// Whether `solid` touches no blocking voxel.
    pub(crate) fn is_clear_of<S: Solid>(&self, solid: &S, unknown: UnknownAs) -> bool {
        match unknown {
            UnknownAs::Blocked => Check::<S, (), true>::new(self.field, solid, &()).run(),
            UnknownAs::Free => Check::<S, (), false>::new(self.field, solid, &()).run(),
        }
    }
}

/// Number of octants and blocks that a collision check visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueryStats {
    /// Octants visited because the summary of their parent was not sufficient.
    pub octants: u32,
    /// Blocks whose voxels were visited.
    pub blocks: u32,
    /// log2 of the edge, in finest voxels, of the smallest cube visited: 0 for voxels, 3 and more for octants; [`u32::MAX`] if none was.
    pub smallest: u32,
}

/// Observer of a check: `()` costs nothing, a cell of [`QueryStats`] counts.
trait Observer {
    fn octant(&self, _level: u32) {}
    fn block(&self) {}
}

impl Observer for () {}

impl Observer for Cell<QueryStats> {
    fn octant(&self, level: u32) {
        let stats = self.get();
        self.set(QueryStats { octants: stats.octants + 1, smallest: stats.smallest.min(level + BLOCK_SHIFT), ..stats });
    }

    fn block(&self) {
        let stats = self.get();
        self.set(QueryStats { blocks: stats.blocks + 1, smallest: 0, ..stats });
    }
}

/// One collision check. `STRICT`: unknown space blocks.
struct Check<'a, S, O, const STRICT: bool> {
    field: &'a OccupancyField,
    solid: &'a S,
    observer: &'a O,
    low: [f32; 3],
    high: [f32; 3],
    slack: f32,
}

impl<'a, S: Solid, O: Observer, const STRICT: bool> Check<'a, S, O, STRICT> {
    const POLICY: UnknownAs = if STRICT { UnknownAs::Blocked } else { UnknownAs::Free };

    fn new(field: &'a OccupancyField, solid: &'a S, observer: &'a O) -> Self {
        let (low, high) = solid.bounds();
        Self { field, solid, observer, low, high, slack: solid.slack() }
    }

    fn run(&self) -> bool {
        let tree = self.field.tree();
        if (0..3).any(|k| self.low[k] > self.high[k]) {
            return true;
        }
        if tree.is_empty() {
            return !STRICT;
        }
        let root = tree.root_level();
        let edge = (BLOCK_EDGE as f32) * (1u32 << root) as f32;
        let corner = block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT);
        let first = corner.map(|c| c as f32);
        let is_inside = (0..3).all(|k| self.low[k] > first[k] && self.high[k] < first[k] + edge);
        if STRICT && !is_inside {
            return false;
        }
        self.descend(tree.root(), corner, root)
    }

    /// Descends while one child contains the whole shape, then into all children that it touches.
    fn descend(&self, octant: &Octant<Summary>, corner: [i32; 3], level: u32) -> bool {
        let (mut octant, mut corner, mut level) = (octant, corner, level);
        loop {
            self.observer.octant(level);
            if is_clear(&octant.payload, Self::POLICY) {
                return true;
            }
            if octant.link == NONE {
                return !self.touches(corner, (BLOCK_EDGE << level) as i32);
            }
            if level == 0 {
                return self.is_block_clear(octant.link, corner);
            }
            let half = ((BLOCK_EDGE << level) / 2) as i32;
            let middle = corner.map(|c| (c + half) as f32);
            let above: [bool; 3] = std::array::from_fn(|k| self.low[k] > middle[k]);
            let below: [bool; 3] = std::array::from_fn(|k| self.high[k] < middle[k]);
            if (0..3).any(|k| !above[k] && !below[k]) {
                return self.check_children(octant.link, corner, level, above, below);
            }
            let child = usize::from(above[0]) | usize::from(above[1]) << 1 | usize::from(above[2]) << 2;
            octant = &self.field.tree().siblings(octant.link)[child];
            (0..3).for_each(|k| corner[k] += if above[k] { half } else { 0 });
            level -= 1;
        }
    }

    /// Checks the children that overlap the bounds, the one around the shape's centre first.
    fn check_children(&self, group: u32, corner: [i32; 3], level: u32, above: [bool; 3], below: [bool; 3]) -> bool {
        let half = ((BLOCK_EDGE << level) / 2) as i32;
        let siblings = self.field.tree().siblings(group);
        let near = (0..3).fold(0, |bits, k| bits | usize::from(0.5 * (self.low[k] + self.high[k]) >= (corner[k] + half) as f32) << k);
        for flip in 0..8usize {
            let i = near ^ flip;
            if (0..3).any(|k| if i >> k & 1 == 1 { below[k] } else { above[k] }) {
                continue;
            }
            if is_clear(&siblings[i].payload, Self::POLICY) {
                self.observer.octant(level - 1);
                continue;
            }
            let at: [i32; 3] = std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { half } else { 0 });
            if self.may_touch(at, half) && !self.descend(&siblings[i], at, level - 1) {
                return false;
            }
        }
        true
    }

    /// Whether the shape touches the leaf of `edge` voxels at `corner`.
    #[inline(always)]
    fn touches(&self, corner: [i32; 3], edge: i32) -> bool {
        self.solid.meets(corner.map(|c| c as f32), corner.map(|c| (c + edge) as f32))
    }

    /// Whether the shape may touch a leaf within the cube.
    #[inline(always)]
    fn may_touch(&self, corner: [i32; 3], edge: i32) -> bool {
        self.solid.meets(corner.map(|c| c as f32 - self.slack), corner.map(|c| (c + edge) as f32 + self.slack))
    }

    fn is_block_clear(&self, id: u32, corner: [i32; 3]) -> bool {
        self.observer.block();
        let block = self.field.block(id);
        let (values, scale) = (self.field.values(block), usize::from(block.scale));
        if scale == 0 {
            return self.are_rows_clear(values, corner);
        }
        let edge = 1 << scale;
        values.iter().enumerate().all(|(i, &value)| {
            let c = voxel_coords(i, scale);
            !blocks(value, Self::POLICY) || !self.touches(std::array::from_fn(|k| corner[k] + ((c[k] << scale) as i32)), edge)
        })
    }

    /// Indices of the block's voxels that the bounds reach along axis `k`.
    #[inline(always)]
    fn reach(&self, corner: [i32; 3], k: usize) -> std::ops::Range<usize> {
        let (low, high) = (self.low[k] - corner[k] as f32, self.high[k] - corner[k] as f32);
        // Negative numbers become 0, large ones the block's edge.
        low as usize..(high as usize + 1).min(edge_at(0))
    }

    /// Checks rows of eight voxels at a time: most blocks have no row with a blocking voxel.
    fn are_rows_clear(&self, values: &[i8], corner: [i32; 3]) -> bool {
        let [xs, ys, zs] = [0, 1, 2].map(|k| self.reach(corner, k));
        let within = if xs.is_empty() { 0 } else { (u64::MAX >> (64 - 8 * xs.len())) << (8 * xs.start) };
        let rows = values.as_chunks::<BLOCK_EDGE>().0;
        for z in zs {
            for y in ys.clone() {
                let row = u64::from_le_bytes(rows[z * BLOCK_EDGE + y].map(|v| v as u8));
                let mut left = blocking_bytes::<STRICT>(row) & within;
                while left != 0 {
                    let x = left.trailing_zeros() as usize / 8;
                    left &= left - 1;
                    if self.touches([corner[0] + x as i32, corner[1] + y as i32, corner[2] + z as i32], 1) {
                        return false;
                    }
                }
            }
        }
        true
    }
}

/// Bits of a voxel's value.
pub(crate) const BITS_OF_BYTE: u32 = 8;

/// The highest bit of every byte of `row` that [`blocks`].
#[inline(always)]
pub(crate) fn blocking_bytes<const STRICT: bool>(row: u64) -> u64 {
    const HIGH: u64 = 0x8080_8080_8080_8080;
    // A byte's lower seven bits are all clear in 0 and in UNKNOWN only; no carry leaves a byte.
    let telling = (row & !HIGH) + !HIGH;
    if STRICT { !(row & telling) & HIGH } else { !row & telling & HIGH }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocking_bytes_equal_blocking_values() {
        for value in i8::MIN..=i8::MAX {
            for place in 0..8 {
                let row = (0x81_u64 << (8 * ((place + 1) % 8))) | u64::from(value as u8) << (8 * place);
                let byte = |mask: u64| mask >> (8 * place) & 0xff;
                assert_eq!(byte(blocking_bytes::<true>(row)) == 0x80, blocks(value, UnknownAs::Blocked), "{value}");
                assert_eq!(byte(blocking_bytes::<false>(row)) == 0x80, blocks(value, UnknownAs::Free), "{value}");
            }
        }
    }
}
