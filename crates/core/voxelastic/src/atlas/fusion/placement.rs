//! Pose of one submap in the lattice of another.

use crate::field::occupancy::BlockBox;
use crate::geometry::{Pose, Rigid};
use crate::octree::{BLOCK_EDGE, block_coords};

/// Margin in voxels around a box of the source: transformed points are rounded.
pub(super) const MARGIN: f32 = 1.0;

/// Pose of the source in the target and its inverse, both in finest voxels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub t_target_source: Rigid,
    pub t_source_target: Rigid,
}

impl Placement {
    /// `t_target_source` in metres, for finest voxels of `voxel_size` metres.
    pub fn new(t_target_source: &Pose, voxel_size: f32) -> Self {
        let in_voxels = |pose: &Pose| {
            let mut pose = *pose;
            pose.translation.vector /= f64::from(voxel_size);
            Rigid::from(&pose)
        };
        Self { t_target_source: in_voxels(t_target_source), t_source_target: in_voxels(&t_target_source.inverse()) }
    }

    /// The middle of block `key` of the source, in the target, finest voxels.
    pub fn middle_in_target(&self, key: u64) -> [f32; 3] {
        self.t_target_source.apply(block_coords(key).map(|c| (c as f32 + 0.5) * BLOCK_EDGE as f32))
    }

    /// The axis-aligned box around a cube of the source, in the target: centre and half extents.
    pub fn box_in_target(&self, centre: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
        transformed_box(&self.t_target_source, centre, half)
    }

    /// The axis-aligned box around a cube of the target, in the source: centre and half extents.
    pub fn box_in_source(&self, centre: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
        transformed_box(&self.t_source_target, centre, half)
    }

    /// The source's blocks that a cube of the target can touch; `centre` and `half` of its edge in finest voxels of the target.
    pub fn blocks_in_source(&self, centre: [f32; 3], half: f32) -> BlockBox {
        let (middle, extent) = self.box_in_source(centre, half);
        let corner = |sign: f32| std::array::from_fn(|k| floor(middle[k] + sign * (extent[k] + MARGIN)));
        BlockBox::of_voxels(corner(-1.0), corner(1.0))
    }

    /// The axis-aligned box around a cuboid of the target, in the source: centre and half extents.
    pub fn cuboid_in_source(&self, centre: [f32; 3], half: [f32; 3]) -> ([f32; 3], [f32; 3]) {
        let t = &self.t_source_target;
        (t.apply(centre), std::array::from_fn(|i| (0..3).map(|k| t.rotation[i][k].abs() * half[k]).sum()))
    }
}

fn transformed_box(t: &Rigid, centre: [f32; 3], half: f32) -> ([f32; 3], [f32; 3]) {
    (t.apply(centre), std::array::from_fn(|i| t.rotation[i].iter().map(|r| r.abs()).sum::<f32>() * half))
}

/// The largest integer not above `x`. `f32::floor` is a function call on processors without the instruction.
#[inline(always)]
pub(super) fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from(whole as f32 > x)
}
