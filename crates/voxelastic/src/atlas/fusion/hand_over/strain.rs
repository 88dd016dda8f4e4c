//! How far corrections move two submaps apart where one of them has blocks of the other.

use crate::atlas::Submap;
use crate::atlas::fusion::alignment::Corrections;
use crate::atlas::fusion::placement::Placement;
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, block_coords};

/// Key bits of a block within a cube in which corrections of scans are taken to move all blocks alike.
const CUBE_BITS: u32 = 9;

/// Where a submap has blocks now, as itself and as a part of another submap.
pub(super) struct Strain {
    as_own: Place,
    as_other: Place,
    /// The last cube that was asked for, and what corrections of scans move there.
    cube: Option<(u64, [f32; 3])>,
}

/// A lattice in the map.
struct Place {
    in_map: Placement,
    corrections: Corrections,
}

impl Place {
    fn corrected(&self, point: [f32; 3]) -> [f32; 3] {
        if self.corrections.is_empty() { [0.0; 3] } else { self.corrections.at(self.in_map.t_target_source.apply(point)) }
    }
}

impl Strain {
    /// Of blocks of `submap` that lay at `t_other_submap` in `other`.
    pub fn new(submap: &Submap, other: &Submap, t_other_submap: &Pose) -> Self {
        let voxel = submap.voxel_size;
        let as_own = Place { in_map: Placement::new(&submap.t_map_submap, voxel), corrections: Corrections::new(submap, &submap.t_map_submap) };
        let pose = other.t_map_submap * t_other_submap;
        let as_other = Place { in_map: Placement::new(&pose, voxel), corrections: Corrections::new(other, &other.t_map_submap) };
        Self { as_own, as_other, cube: None }
    }

    /// How far the middle of block `key` of the submap is from where it is as a part of the other one, finest voxels. Faster for keys in ascending order.
    pub fn at(&mut self, key: u64) -> f32 {
        let cube = key >> CUBE_BITS;
        let by_scans = match self.cube {
            Some((known, by_scans)) if known == cube => by_scans,
            _ => {
                let middle = block_coords(cube << CUBE_BITS).map(|c| (c as f32 + 4.0) * BLOCK_EDGE as f32);
                let (own, other) = (self.as_own.corrected(middle), self.as_other.corrected(middle));
                self.cube.insert((cube, std::array::from_fn(|k| own[k] - other[k]))).1
            }
        };
        let (own, other) = (self.as_own.in_map.middle_in_target(key), self.as_other.in_map.middle_in_target(key));
        (0..3).map(|k| (own[k] - other[k] + by_scans[k]).powi(2)).sum::<f32>().sqrt()
    }
}
