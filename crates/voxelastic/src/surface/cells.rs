//! A block with a rim of its neighbours' voxels: the corners of the dual cells that the block may own.

use super::view::View;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, block_coords, block_key, edge_at, voxel_coords, voxel_index};

/// A voxel, by block and index in its array as the view sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Corner {
    /// Which of the 27 blocks around (13 is the block itself).
    pub neighbour: u8,
    /// Index in that block's array.
    pub voxel: u16,
}

/// The samples around one block: its own voxels and a rim one voxel wide.
pub(super) struct Padded {
    /// Ids of the 27 blocks, x fastest; [`NONE`] where there is none.
    pub ids: [u32; 27],
    /// Their scales; 0 where there is none.
    pub scales: [u8; 27],
    /// The block's scale and its edge in voxels of that scale.
    pub scale: usize,
    pub edge: usize,
    /// Smallest corner of the block in finest voxels.
    pub origin: [i32; 3],
    /// Distances in finest voxels; NaN where unobserved, infinite where the neighbour is finer.
    pub distances: Vec<f32>,
    corners: Vec<Corner>,
}

pub(super) const CENTRE: usize = 13;

impl Padded {
    pub fn new() -> Self {
        let samples = (BLOCK_EDGE + 2).pow(3);
        Self {
            ids: [NONE; 27],
            scales: [0; 27],
            scale: 0,
            edge: 0,
            origin: [0; 3],
            distances: vec![f32::NAN; samples],
            corners: vec![Corner { neighbour: 0, voxel: 0 }; samples],
        }
    }

    /// Index of the sample at voxel `c` of the block; -1 and `edge` lie on the rim.
    #[inline(always)]
    pub fn at(&self, c: [i32; 3]) -> usize {
        let width = self.edge + 2;
        (c[0] + 1) as usize + ((c[1] + 1) as usize + (c[2] + 1) as usize * width) * width
    }

    #[inline(always)]
    pub fn corner(&self, sample: usize) -> Corner {
        self.corners[sample]
    }

    /// Centre of a voxel in finest voxels, submap frame.
    pub fn position(&self, corner: Corner) -> [f32; 3] {
        let scale = usize::from(self.scales[usize::from(corner.neighbour)]);
        let c = voxel_coords(usize::from(corner.voxel), scale);
        let offset = neighbour_offset(usize::from(corner.neighbour));
        std::array::from_fn(|k| (self.origin[k] + offset[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * (1 << scale) as f32)
    }

    /// Loads block `id` with its rim. Returns false when no surface can pass through it: all samples on one side.
    pub fn load(&mut self, view: &View<'_>, cursor: &mut Cursor, id: u32, min_weight: u16) -> bool {
        let block = view.field.block(id);
        let coords = block_coords(block.key);
        self.scale = view.scale(id);
        self.edge = edge_at(self.scale);
        self.origin = coords.map(|c| c * BLOCK_EDGE as i32);
        for (i, slot) in self.ids.iter_mut().enumerate() {
            let offset = neighbour_offset(i);
            *slot = if i == CENTRE {
                id
            } else {
                cursor.block(view.field.tree(), block_key(std::array::from_fn(|k| coords[k] + offset[k]))).unwrap_or(NONE)
            };
            self.scales[i] = if *slot == NONE { 0 } else { view.scale(*slot) as u8 };
        }
        let n = self.edge as i32;
        let (mut front, mut behind) = (false, false);
        let mut note = |distance: f32| {
            front |= distance >= 0.0 && distance.is_finite();
            behind |= distance < 0.0;
        };
        for z in -1..=n {
            for y in -1..=n {
                for x in -1..=n {
                    let sample = self.at([x, y, z]);
                    let (corner, distance) = self.sample(view, [x, y, z], min_weight);
                    self.corners[sample] = corner;
                    self.distances[sample] = distance;
                    note(distance);
                }
            }
        }
        front && behind
    }

    #[inline(always)]
    fn sample(&self, view: &View<'_>, c: [i32; 3], min_weight: u16) -> (Corner, f32) {
        let n = self.edge as i32;
        let side = c.map(|v| if v < 0 { 0 } else { 1 + usize::from(v >= n) });
        let neighbour = side[0] + 3 * side[1] + 9 * side[2];
        let id = self.ids[neighbour];
        let scale = usize::from(self.scales[neighbour]);
        let mut corner = Corner { neighbour: neighbour as u8, voxel: 0 };
        if id == NONE {
            return (corner, f32::NAN);
        }
        if scale < self.scale {
            return (corner, f32::INFINITY);
        }
        let local = c.map(|v| ((v + n) % n) as usize >> (scale - self.scale));
        corner.voxel = voxel_index(local, scale) as u16;
        let voxel = view.voxels(id)[usize::from(corner.voxel)];
        let distance = if voxel.weight >= min_weight { voxel.distance_in_voxels() * (1 << scale) as f32 } else { f32::NAN };
        (corner, distance)
    }
}

/// Offset in blocks of neighbour `i` of 27.
#[inline(always)]
pub(super) fn neighbour_offset(i: usize) -> [i32; 3] {
    [(i % 3) as i32 - 1, (i / 3 % 3) as i32 - 1, (i / 9) as i32 - 1]
}
