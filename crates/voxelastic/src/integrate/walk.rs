//! The kernel of both integrators: walk lines through the voxels of blocks, sixteen at a time.
//!
//! Each line lies in a block of its own or shares it with others; a step of all sixteen is a handful of vector instructions,
//! because which face a line crosses next is as good as random and a branch on it would be mispredicted at every other voxel.
//! What the lines pass is noted first and applied afterwards, so that its memory can be asked for in between.
#![allow(clippy::needless_range_loop)] // A lane, or an axis, is an index into many arrays here.

use crate::geometry::whole;
use crate::octree::BLOCK_EDGE;

/// Lines that are walked at once.
pub(crate) const LANES: usize = 16;
/// Most voxels of a block that a line passes: it crosses at most seven inner faces along each axis.
pub(crate) const MAX_STEPS: usize = 3 * (BLOCK_EDGE - 1) + 1;

type Lanes<T> = [T; LANES];

/// A line through a block. Lengths count finest voxels of the submap, but for the parameters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    /// The measured point; parameters along the line are zero here.
    pub point: [f32; 3],
    /// Unit direction, from the sensor to the point.
    pub direction: [f32; 3],
    /// A linear quantity that is zero at the point: its change per voxel along each axis.
    pub gradient: [f32; 3],
    /// The block's smallest corner.
    pub corner: [f32; 3],
    /// The block's scale: voxels have an edge of 2^scale finest voxels.
    pub scale: u32,
    /// First and last parameter of interest, in voxels of the block's scale.
    pub reach: [f32; 2],
}

/// Sixteen lines, one array per quantity.
#[derive(Clone, Debug)]
pub(crate) struct Lines {
    point: [Lanes<f32>; 3],
    direction: [Lanes<f32>; 3],
    gradient: [Lanes<f32>; 3],
    corner: [Lanes<f32>; 3],
    /// One over the edge of a voxel in finest voxels, and the edge of the block in voxels.
    per_voxel: Lanes<f32>,
    edge: Lanes<i32>,
    enter: Lanes<f32>,
    leave: Lanes<f32>,
    len: usize,
}

impl Lines {
    pub fn new() -> Self {
        let none = [[1.0; LANES]; 3];
        let (per_voxel, edge) = ([1.0; LANES], [8; LANES]);
        // A line that leaves before it enters passes nothing.
        Self { point: none, direction: none, gradient: none, corner: none, per_voxel, edge, enter: [1.0; LANES], leave: [0.0; LANES], len: 0 }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    /// Forgets all lines.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.leave = [f32::NEG_INFINITY; LANES];
        self.len = 0;
    }

    /// Adds a line; there must be fewer than [`LANES`].
    #[inline(always)]
    pub fn push(&mut self, line: &Line) {
        let lane = self.len % LANES;
        for k in 0..3 {
            self.point[k][lane] = line.point[k];
            self.direction[k][lane] = line.direction[k];
            self.gradient[k][lane] = line.gradient[k];
            self.corner[k][lane] = line.corner[k];
        }
        // 2^-scale.
        self.per_voxel[lane] = f32::from_bits((127 - line.scale) << 23);
        self.edge[lane] = BLOCK_EDGE as i32 >> line.scale;
        [self.enter[lane], self.leave[lane]] = line.reach;
        self.len += 1;
    }
}

/// What sixteen lines pass, step by step.
#[derive(Clone, Debug)]
pub(crate) struct Trace {
    /// Index of the voxel in its block's array.
    pub index: [Lanes<u32>; MAX_STEPS],
    /// The line's quantity at the voxel's centre.
    pub quantity: [Lanes<f32>; MAX_STEPS],
    /// Voxels that each line passes.
    pub steps: Lanes<u32>,
    /// The most of them.
    pub longest: usize,
}

impl Trace {
    pub fn new() -> Self {
        Self { index: [[0; LANES]; MAX_STEPS], quantity: [[0.0; LANES]; MAX_STEPS], steps: [0; LANES], longest: 0 }
    }

    /// Walks `lines`.
    #[inline(always)]
    pub fn walk(&mut self, lines: &Lines) {
        let mut walk = Walk::new(lines);
        self.steps = [0; LANES];
        self.longest = 0;
        while self.longest < MAX_STEPS {
            let (index, quantity) = (&mut self.index[self.longest], &mut self.quantity[self.longest]);
            let mut passing = 0u32;
            for lane in 0..LANES {
                index[lane] = walk.index[lane] as u32 & walk.last[lane];
                quantity[lane] = walk.quantity[lane];
                self.steps[lane] += walk.alive[lane] & 1;
                passing |= walk.alive[lane];
            }
            if passing == 0 {
                break;
            }
            self.longest += 1;
            walk.step();
        }
    }
}

/// Where sixteen lines are.
struct Walk {
    index: Lanes<i32>,
    /// Largest index of the block's array.
    last: Lanes<u32>,
    stride: [Lanes<i32>; 3],
    /// Parameter at which the next face is crossed, per axis, and between two such faces.
    next: [Lanes<f32>; 3],
    crossing: [Lanes<f32>; 3],
    quantity: Lanes<f32>,
    slope: [Lanes<f32>; 3],
    leave: Lanes<f32>,
    /// All bits set while the line is in its block and within its reach.
    alive: Lanes<u32>,
}

impl Walk {
    /// Puts each line to where it enters its block, or the part of it that is of interest.
    #[inline(always)]
    fn new(lines: &Lines) -> Self {
        let (mut point, mut inverse) = ([[0f32; LANES]; 3], [[0f32; LANES]; 3]);
        let (mut enter, mut leave) = (lines.enter, lines.leave);
        for k in 0..3 {
            for lane in 0..LANES {
                let p = (lines.point[k][lane] - lines.corner[k][lane]) * lines.per_voxel[lane];
                let d = lines.direction[k][lane];
                let i = 1.0 / if d.abs() < 1e-9 { 1e-9f32.copysign(d) } else { d };
                let (a, b) = (-p * i, (lines.edge[lane] as f32 - p) * i);
                let (near, far) = if a < b { (a, b) } else { (b, a) };
                enter[lane] = if near > enter[lane] { near } else { enter[lane] };
                leave[lane] = if far < leave[lane] { far } else { leave[lane] };
                point[k][lane] = p;
                inverse[k][lane] = i;
            }
        }
        let mut walk = Self {
            index: [0; LANES],
            last: [0; LANES],
            stride: [[0; LANES]; 3],
            next: [[0.0; LANES]; 3],
            crossing: [[0.0; LANES]; 3],
            quantity: [0.0; LANES],
            slope: [[0.0; LANES]; 3],
            leave,
            alive: [0; LANES],
        };
        let mut stride = [1i32; LANES];
        for k in 0..3 {
            for lane in 0..LANES {
                let (direction, edge) = (lines.direction[k][lane], lines.edge[lane]);
                let at = point[k][lane] + enter[lane] * direction;
                // Not `clamp`, which would also care for NaN.
                let at = if at > 0.0 { at } else { 0.0 };
                let cell = whole(if at < (edge - 1) as f32 { at } else { (edge - 1) as f32 });
                let ahead = direction > 0.0;
                walk.index[lane] += cell * stride[lane];
                walk.stride[k][lane] = if ahead { stride[lane] } else { -stride[lane] };
                walk.next[k][lane] = ((cell + i32::from(ahead)) as f32 - point[k][lane]) * inverse[k][lane];
                walk.crossing[k][lane] = inverse[k][lane].abs();
                walk.slope[k][lane] = if ahead { lines.gradient[k][lane] } else { -lines.gradient[k][lane] };
                walk.quantity[lane] += lines.gradient[k][lane] * (cell as f32 + 0.5 - point[k][lane]);
                stride[lane] *= edge;
            }
        }
        for lane in 0..LANES {
            walk.last[lane] = (stride[lane] - 1) as u32;
            // The last step must not leave the block through rounding: a line within this of a face does not count as beyond it.
            walk.leave[lane] -= 1e-4;
            walk.alive[lane] = mask(enter[lane] < walk.leave[lane]);
        }
        walk
    }

    /// Each line crosses its nearest face.
    #[inline(always)]
    fn step(&mut self) {
        for lane in 0..LANES {
            let [a, b, c] = [self.next[0][lane], self.next[1][lane], self.next[2][lane]];
            // Not `min`, which would also care for NaN.
            let nearest = if a < b { a } else { b };
            let nearest = if nearest < c { nearest } else { c };
            let x = mask(a <= nearest);
            let y = mask(b <= nearest) & !x;
            let z = !(x | y);
            self.alive[lane] &= mask(nearest < self.leave[lane]);
            self.index[lane] += (self.stride[0][lane] & x as i32) + (self.stride[1][lane] & y as i32) + (self.stride[2][lane] & z as i32);
            self.quantity[lane] += select(self.slope[0][lane], x) + select(self.slope[1][lane], y) + select(self.slope[2][lane], z);
            self.next[0][lane] = a + select(self.crossing[0][lane], x);
            self.next[1][lane] = b + select(self.crossing[1][lane], y);
            self.next[2][lane] = c + select(self.crossing[2][lane], z);
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::voxel_index;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    /// Voxels that hold one of many samples along a line: how deep inside the deepest lies, and the quantity at the centre.
    fn sampled(line: &Line) -> BTreeMap<usize, (f32, f32)> {
        let voxel = (1 << line.scale) as f32;
        let edge = (BLOCK_EDGE >> line.scale) as f32;
        let mut voxels = BTreeMap::new();
        for s in 0..=4000 {
            let t = line.reach[0] + (line.reach[1] - line.reach[0]) * s as f32 / 4000.0;
            let at: [f32; 3] = std::array::from_fn(|k| (line.point[k] - line.corner[k]) / voxel + t * line.direction[k]);
            if at.iter().all(|c| (0.0..edge).contains(c)) {
                let depth = at.iter().map(|c| (c - c.round()).abs()).fold(0.5, f32::min);
                let cell = at.map(|c| c as usize);
                let quantity = (0..3).map(|k| line.gradient[k] * (cell[k] as f32 + 0.5 - (line.point[k] - line.corner[k]) / voxel)).sum();
                let best = voxels.entry(voxel_index(cell, line.scale as usize)).or_insert((0f32, quantity));
                best.0 = best.0.max(depth);
            }
        }
        voxels
    }

    fn line() -> impl Strategy<Value = Line> {
        let unit = prop::array::uniform3(-1f32..1.0).prop_filter_map("a direction", |v| {
            let length = v.iter().map(|c| c * c).sum::<f32>().sqrt();
            (length > 0.1).then(|| v.map(|c| c / length))
        });
        (
            prop::array::uniform3(-3f32..11.0),
            unit,
            prop::array::uniform3(-1f32..1.0),
            prop::array::uniform3(-40i32..40),
            0u32..4,
            -6f32..0.0,
            0f32..6.0,
        )
            .prop_map(|(within, direction, gradient, corner, scale, from, to)| {
                let corner = corner.map(|c| (c * 8) as f32);
                let point = std::array::from_fn(|k| corner[k] + within[k]);
                Line { point, direction, gradient, corner, scale, reach: [from, to] }
            })
    }

    proptest! {
        #[test]
        fn walks_pass_the_voxels_that_samples_lie_in(lines in prop::collection::vec(line(), 0..=LANES)) {
            let (mut batch, mut trace) = (Lines::new(), Trace::new());
            batch.clear();
            lines.iter().for_each(|line| batch.push(line));
            trace.walk(&batch);
            prop_assert!(trace.steps[lines.len()..].iter().all(|&n| n == 0));
            for (lane, line) in lines.iter().enumerate() {
                let slow = sampled(line);
                let fast: BTreeMap<usize, f32> = (0..trace.steps[lane] as usize).map(|s| (trace.index[s][lane] as usize, trace.quantity[s][lane])).collect();
                prop_assert_eq!(fast.len(), trace.steps[lane] as usize, "a voxel twice");
                for (voxel, (depth, quantity)) in &slow {
                    prop_assert!(fast.contains_key(voxel) || *depth < 2e-3, "missed {voxel}, {depth} deep");
                    prop_assert!(fast.get(voxel).is_none_or(|q| (q - quantity).abs() < 1e-3));
                }
                prop_assert!(fast.keys().filter(|v| !slow.contains_key(v)).count() <= 1 + fast.len() / 3, "{fast:?} {slow:?}");
            }
        }
    }
}
