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
#[allow(clippy::needless_range_loop)] // An axis is an index into four arrays here.
pub(crate) fn walk_line<const SCALE: usize>(line: &Line, mut enter: f32, mut leave: f32, mut visit: impl FnMut(usize, f32)) {
    let edge = (BLOCK_EDGE >> SCALE) as i32;
    let shift = 3 - SCALE;
    let size = edge as f32;
    let mut inverse = [0f32; 3];
    for k in 0..3 {
        let d = line.direction[k];
        inverse[k] = 1.0 / if d.abs() < 1e-9 { 1e-9f32.copysign(d) } else { d };
        let (a, b) = (-line.point[k] * inverse[k], (size - line.point[k]) * inverse[k]);
        let (near, far) = if a < b { (a, b) } else { (b, a) };
        enter = if near > enter { near } else { enter };
        leave = if far < leave { far } else { leave };
    }
    // The last step must not leave the block through rounding: a line within this of a face does not count as beyond it.
    leave -= 1e-4;
    if enter >= leave {
        return;
    }
    let mut index = 0;
    let mut stride = [0i32; 3];
    let mut next = [0f32; 3];
    let mut slope = [0f32; 3];
    let mut quantity = 0.0;
    for k in 0..3 {
        let at = line.point[k] + enter * line.direction[k];
        let cell = (at as i32).clamp(0, edge - 1);
        let ahead = line.direction[k] > 0.0;
        index += cell << (k * shift);
        stride[k] = if ahead { 1 } else { -1 } << (k * shift);
        next[k] = ((cell + i32::from(ahead)) as f32 - line.point[k]) * inverse[k];
        slope[k] = line.gradient[k] * if ahead { 1.0 } else { -1.0 };
        quantity += line.gradient[k] * (cell as f32 + 0.5 - line.point[k]);
    }
    let crossing = inverse.map(f32::abs);
    loop {
        visit(index as usize & (edge as usize * edge as usize * edge as usize - 1), quantity);
        // Not `min`, which would also care for NaN.
        let nearest = if next[0] < next[1] { next[0] } else { next[1] };
        let nearest = if nearest < next[2] { nearest } else { next[2] };
        if nearest >= leave {
            break;
        }
        // Which face is crossed is as good as random: masks, because a branch would be mispredicted at every other voxel.
        let x = mask(next[0] <= nearest);
        let y = mask(next[1] <= nearest) & !x;
        let z = !(x | y);
        index += (stride[0] & x as i32) + (stride[1] & y as i32) + (stride[2] & z as i32);
        quantity += select(slope[0], x) + select(slope[1], y) + select(slope[2], z);
        next[0] += select(crossing[0], x);
        next[1] += select(crossing[1], y);
        next[2] += select(crossing[2], z);
    }
}

/// All bits set for true.
#[inline(always)]
fn mask(condition: bool) -> u32 {
    u32::from(condition).wrapping_neg()
}

/// `value` where the mask is set, zero elsewhere.
#[inline(always)]
fn select(value: f32, mask: u32) -> f32 {
    f32::from_bits(value.to_bits() & mask)
}

/// A point in finest voxels of the submap, in voxels of a block at `SCALE` relative to the block's smallest corner.
#[inline(always)]
pub(crate) fn local<const SCALE: usize>(point: [f32; 3], corner: [f32; 3]) -> [f32; 3] {
    let per_voxel = 1.0 / (1 << SCALE) as f32;
    std::array::from_fn(|k| (point[k] - corner[k]) * per_voxel)
}
