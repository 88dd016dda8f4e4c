//! The kernel of both integrators: walk one line through the voxels of one block.

use crate::octree::BLOCK_EDGE;

/// A line through a block, in voxels of the block's scale, relative to the block's smallest corner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    /// The measured point; parameters along the line are zero here.
    pub point: [f32; 3],
    /// Unit direction, from the sensor to the point.
    pub direction: [f32; 3],
    /// A linear quantity that is zero at the point: its change per voxel along each axis.
    pub gradient: [f32; 3],
}

/// Calls `visit(voxel index, quantity at the voxel's centre)` for every voxel of a block at `SCALE` that the line passes
/// through between the parameters `enter` and `leave`.
#[inline(always)]
pub(crate) fn walk_line<const SCALE: usize>(line: &Line, mut enter: f32, mut leave: f32, mut visit: impl FnMut(usize, f32)) {
    let edge = (BLOCK_EDGE >> SCALE) as i32;
    let shift = 3 - SCALE;
    let size = edge as f32;
    let mut inverse = [0f32; 3];
    for k in 0..3 {
        let d = line.direction[k];
        inverse[k] = 1.0 / if d.abs() < 1e-9 { 1e-9f32.copysign(d) } else { d };
        let (a, b) = (-line.point[k] * inverse[k], (size - line.point[k]) * inverse[k]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    if enter >= leave {
        return;
    }
    let mut cell = [0i32; 3];
    let mut step = [0i32; 3];
    let mut next = [0f32; 3];
    let mut quantity = 0.0;
    for k in 0..3 {
        let at = line.point[k] + enter * line.direction[k];
        cell[k] = (at as i32).clamp(0, edge - 1);
        let ahead = line.direction[k] > 0.0;
        step[k] = if ahead { 1 } else { -1 };
        next[k] = ((cell[k] + i32::from(ahead)) as f32 - line.point[k]) * inverse[k];
        quantity += line.gradient[k] * (cell[k] as f32 + 0.5 - line.point[k]);
    }
    let crossing = inverse.map(f32::abs);
    let slope: [f32; 3] = std::array::from_fn(|k| line.gradient[k] * step[k] as f32);
    loop {
        visit((cell[0] | cell[1] << shift | cell[2] << (2 * shift)) as usize, quantity);
        let axis = if next[0] <= next[1] && next[0] <= next[2] {
            0
        } else if next[1] <= next[2] {
            1
        } else {
            2
        };
        if next[axis] >= leave {
            break;
        }
        cell[axis] += step[axis];
        if cell[axis] as u32 >= edge as u32 {
            break;
        }
        next[axis] += crossing[axis];
        quantity += slope[axis];
    }
}

/// A point in finest voxels of the submap, in voxels of a block at `SCALE` relative to the block's smallest corner.
#[inline(always)]
pub(crate) fn local<const SCALE: usize>(point: [f32; 3], corner: [f32; 3]) -> [f32; 3] {
    let per_voxel = 1.0 / (1 << SCALE) as f32;
    std::array::from_fn(|k| (point[k] - corner[k]) * per_voxel)
}
