//! Closing gaps: a voxel that no beam met, between two on opposite sides that were, is given the mean of them.
//!
//! Beams leave gaps of a voxel everywhere; marching cubes, which needs all eight corners of a cell, makes a hole of each. What
//! lies between two observed voxels is interpolated, never extrapolated, so that the surface grows nowhere.

use super::cells::bits;
use super::padded::{LAYER, Padded, ROW};
use crate::octree::NONE;

/// Neighbours that differ by more than this many voxels belong to different surfaces: a distance changes by one at most.
const MOST_STEP: f32 = 1.5;

/// Closes gaps in the block and the first ring of its rim, from what was observed, at the block's own scale.
///
/// Blocks that see the same voxel must agree on it, so nothing is closed next to finer blocks, which cannot know.
pub(super) fn close(padded: &mut Padded) {
    if padded.edge == 1 {
        return;
    }
    let n = padded.edge as i32;
    let native = padded.rows_of_blocks(|i| padded.ids[i] != NONE && usize::from(padded.scales[i]) == padded.scale);
    let finer = padded.rows_of_blocks(|i| padded.ids[i] != NONE && usize::from(padded.scales[i]) < padded.scale);
    let of = |rows: &[[u16; 3]; 3], y: i32, z: i32| rows[padded.side(z)][padded.side(y)];
    let observed = |y: i32, z: i32| padded.known[Padded::row(y, z)] & of(&native, y, z);
    let beside_finer = |y: i32, z: i32| {
        let around = |row: i32| of(&finer, y - 1, row) | of(&finer, y, row) | of(&finer, y + 1, row);
        let any = around(z - 1) | around(z) | around(z + 1);
        any | any << 1 | any >> 1
    };
    let voxel = (1 << padded.scale) as f32;
    let inside = ((1u32 << (n + 2)) - 1) << Padded::bit(-1);
    let mut closed = Vec::new();
    for z in -1..=n {
        for y in -1..=n {
            let here = observed(y, z);
            let along = (here << 1) & (here >> 1);
            let across = observed(y - 1, z) & observed(y + 1, z);
            let upward = observed(y, z - 1) & observed(y, z + 1);
            let row = Padded::row(y, z);
            let mut gaps = (along | across | upward) & !padded.known[row] & of(&native, y, z) & inside as u16;
            if !padded.uniform {
                gaps &= !beside_finer(y, z);
            }
            for bit in bits(gaps) {
                let sample = row * ROW + bit as usize;
                let pairs = [(along, 1), (across, ROW), (upward, LAYER * ROW)];
                if let Some(distance) = between(padded, sample, pairs.map(|(mask, step)| (mask >> bit & 1 == 1).then_some(step)), voxel) {
                    closed.push((row, bit, distance));
                }
            }
        }
    }
    for (row, bit, distance) in closed {
        padded.distances[row * ROW + bit as usize] = distance;
        padded.known[row] |= 1 << bit;
        padded.behind[row] |= u16::from(distance < 0.0) << bit;
    }
}

/// The mean of the pairs of samples `steps` to either side of `sample`, unless it is far from one of the neighbours.
fn between(padded: &Padded, sample: usize, pairs: [Option<usize>; 3], voxel: f32) -> Option<f32> {
    let (mut sum, mut count) = (0.0, 0.0);
    for step in pairs.into_iter().flatten() {
        sum += padded.distances[sample - step] + padded.distances[sample + step];
        count += 2.0;
    }
    let mean = sum / count;
    // Comparisons with NaN, the unknown, are false.
    let far = |step: usize| [sample - step, sample + step].iter().any(|&s| (padded.distances[s] - mean).abs() > MOST_STEP * voxel);
    (![1, ROW, LAYER * ROW].into_iter().any(far)).then_some(mean)
}
