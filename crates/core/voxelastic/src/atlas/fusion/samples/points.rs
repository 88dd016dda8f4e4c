//! Points of the target among the cells of the source.
#![allow(clippy::needless_range_loop)] // Kernels are loops: closures are not inlined into code for other instruction sets.

use crate::octree::voxels_at;

/// Voxels of a block at the finest scale.
const CAPACITY: usize = voxels_at(0);
/// Points that are worked on together, at most: so many that the compiler makes loops of it, and vectors within them.
pub(crate) const LANES: usize = 64;
/// Numbers of points that are worked on together are multiples of this.
const GROUP: usize = 16;

/// Some voxels of a block of the target, as points among voxels of the source: the lowest voxel of the cell around the point, and how far
/// beyond its centre the point is.
pub(crate) struct Points {
    len: usize,
    /// Index of each in its block.
    pub voxel: [u16; CAPACITY],
    base: [[i32; CAPACITY]; 3],
    pub fraction: [[f32; CAPACITY]; 3],
}

impl Points {
    /// No points.
    pub fn new() -> Self {
        Self { len: 0, voxel: [0; CAPACITY], base: [[0; CAPACITY]; 3], fraction: [[0.0; CAPACITY]; 3] }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    pub fn clear(&mut self) {
        self.len = 0;
    }

    /// Adds the point of voxel `voxel`.
    #[inline(always)]
    pub fn push(&mut self, voxel: usize, (base, fraction): ([i32; 3], [f32; 3])) {
        let i = self.len % CAPACITY;
        self.voxel[i] = voxel as u16;
        for k in 0..3 {
            (self.base[k][i], self.fraction[k][i]) = (base[k], fraction[k]);
        }
        self.len = i + 1;
    }

    /// The cell around point `i`.
    #[inline(always)]
    pub fn cell(&self, i: usize) -> [i32; 3] {
        [self.base[0][i], self.base[1][i], self.base[2][i]]
    }

    /// Number of lanes for the points from `first` on; lanes beyond the last point repeat it once [`fill_lanes`](Self::fill_lanes) was called.
    #[inline(always)]
    pub fn lanes(&self, first: usize) -> usize {
        (self.len - first).min(LANES).next_multiple_of(GROUP)
    }

    /// Repeats the last point until whole groups are filled, without counting the repetitions.
    #[inline(always)]
    pub fn fill_lanes(&mut self) {
        let len = self.len;
        for i in len..len.next_multiple_of(GROUP).min(CAPACITY) {
            for k in 0..3 {
                (self.base[k][i], self.fraction[k][i]) = (self.base[k][len - 1], self.fraction[k][len - 1]);
            }
        }
    }
}
