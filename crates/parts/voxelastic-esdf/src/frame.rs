//! Where points of the map are in a submap, and between which of its voxels.

use voxelastic::Pose;
use voxelastic::atlas::Submap;
use voxelastic::octree::{BLOCK_EDGE, MAX_BLOCK_COORD, block_coords};

/// The frame of a submap in that of the map, and how far distances to what is in it reach.
pub(crate) struct SubmapFrame {
    /// Rows of the rotation from the map frame to the submap frame, and the translation.
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    /// Box around the submap's voxels and what is within reach of them, submap frame, metres.
    low: [f64; 3],
    high: [f64; 3],
}

impl SubmapFrame {
    /// Of a submap at a pose, with finest voxels of `voxel` metres and distances up to `max_distance` metres.
    pub fn new(submap: &Submap, t_map_submap: &Pose, voxel: f64, max_distance: f64) -> Self {
        let t_submap_map = t_map_submap.inverse();
        let rotation = t_submap_map.rotation.to_rotation_matrix();
        let (key, level) = match submap.occupancy().is_empty() {
            true => (submap.tsdf().tree().root_key(), submap.tsdf().tree().root_level()),
            false => (submap.occupancy().tree().root_key(), submap.occupancy().tree().root_level()),
        };
        let block = BLOCK_EDGE as f64 * voxel;
        let low = block_coords(key).map(|c| f64::from(c) * block - max_distance);
        Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)])),
            translation: t_submap_map.translation.vector.into(),
            low,
            high: low.map(|c| c + f64::from(1u32 << level) * block + 2.0 * max_distance),
        }
    }

    pub fn to_submap(&self, p: [f64; 3]) -> [f64; 3] {
        let r = &self.rotation;
        std::array::from_fn(|i| r[i][0] * p[0] + r[i][1] * p[1] + r[i][2] * p[2] + self.translation[i])
    }

    /// A direction in the submap, in the frame of the map.
    pub fn to_map(&self, direction: [f32; 3]) -> [f32; 3] {
        let (r, d) = (&self.rotation, direction.map(f64::from));
        std::array::from_fn(|j| (r[0][j] * d[0] + r[1][j] * d[1] + r[2][j] * d[2]) as f32)
    }

    pub fn reaches(&self, p: &[f64; 3]) -> bool {
        (0..3).all(|k| p[k] >= self.low[k] && p[k] <= self.high[k])
    }
}

/// The voxel with the least coordinates of the eight around `p` (submap frame, metres), and how far `p` is from its centre to the next ones; none outside of what
/// octrees can hold.
#[inline]
pub(crate) fn corner_below(p: [f64; 3], voxel: f64) -> Option<([i32; 3], [f32; 3])> {
    const LIMIT: f64 = (MAX_BLOCK_COORD - 1) as f64 * BLOCK_EDGE as f64;
    // Between the centres of voxels.
    let q = p.map(|c| c / voxel - 0.5);
    if q.iter().any(|c| c.abs() > LIMIT) {
        return None;
    }
    let base = q.map(f64::floor);
    Some((base.map(|c| c as i32), std::array::from_fn(|k| (q[k] - base[k]) as f32)))
}
