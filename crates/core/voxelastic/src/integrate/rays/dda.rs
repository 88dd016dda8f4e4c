//! Traversal of voxels along rays (a digital differential analyser), sixteen rays at a time: the kernel of both integrators.
//!
//! Each ray is cut to the block that it passes ([`Segment`]). A step of all sixteen is a handful of vector instructions, because which face a ray crosses next
//! is unpredictable and a branch on it would be mispredicted at every other voxel. Voxels are first collected and updated later, so that they can be
//! prefetched in between.
#![allow(clippy::needless_range_loop)] // Lanes and axes index many arrays at once.

use crate::octree::BLOCK_EDGE;
use crate::simd::floor_positive;

/// Segments that are traversed at once.
pub(crate) const LANES: usize = 16;
/// Most voxels of a block that a segment passes: it crosses at most seven inner faces along each axis.
pub(crate) const MAX_STEPS: usize = 3 * (BLOCK_EDGE - 1) + 1;

type Lanes<T> = [T; LANES];

/// The part of a ray within a block. Lengths count finest voxels of the submap, except for `interval`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment {
    /// The measured point: parameter 0 of the ray.
    pub point: [f32; 3],
    /// Unit direction, from the sensor to the point.
    pub direction: [f32; 3],
    /// Gradient of a linear quantity that is zero at the point: its change per voxel along each axis.
    pub gradient: [f32; 3],
    /// The block's smallest corner.
    pub corner: [f32; 3],
    /// Scale of the block: its voxels are 2^scale finest voxels wide.
    pub scale: u32,
    /// First and last parameter of interest, in voxels of the block's scale.
    pub interval: [f32; 2],
}

/// Sixteen segments, one array per quantity.
#[derive(Clone, Debug)]
pub(crate) struct SegmentLanes {
    point: [Lanes<f32>; 3],
    direction: [Lanes<f32>; 3],
    gradient: [Lanes<f32>; 3],
    corner: [Lanes<f32>; 3],
    /// 1 / edge of a voxel in finest voxels, and the edge of the block in voxels.
    per_voxel: Lanes<f32>,
    edge: Lanes<i32>,
    enter: Lanes<f32>,
    leave: Lanes<f32>,
    len: usize,
}

impl SegmentLanes {
    pub fn new() -> Self {
        let none = [[1.0; LANES]; 3];
        let (per_voxel, edge) = ([1.0; LANES], [8; LANES]);
        // Unused lanes leave before they enter and pass nothing.
        Self { point: none, direction: none, gradient: none, corner: none, per_voxel, edge, enter: [1.0; LANES], leave: [0.0; LANES], len: 0 }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    /// Removes all segments.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.leave = [f32::NEG_INFINITY; LANES];
        self.len = 0;
    }

    /// Adds a segment; there must be fewer than [`LANES`].
    #[inline(always)]
    pub fn push(&mut self, segment: &Segment) {
        let lane = self.len % LANES;
        for k in 0..3 {
            self.point[k][lane] = segment.point[k];
            self.direction[k][lane] = segment.direction[k];
            self.gradient[k][lane] = segment.gradient[k];
            self.corner[k][lane] = segment.corner[k];
        }
        // 2^-scale.
        self.per_voxel[lane] = f32::from_bits((127 - segment.scale) << 23);
        self.edge[lane] = BLOCK_EDGE as i32 >> segment.scale;
        [self.enter[lane], self.leave[lane]] = segment.interval;
        self.len += 1;
    }
}

/// The voxels that sixteen segments pass, step by step.
#[derive(Clone, Debug)]
pub(crate) struct Traversal {
    /// Index of the voxel in its block's array.
    pub index: [Lanes<u32>; MAX_STEPS],
    /// The segment's linear quantity at the voxel's centre.
    pub quantity: [Lanes<f32>; MAX_STEPS],
    /// Number of voxels that each segment passes.
    pub steps: Lanes<u32>,
    /// Largest of these numbers.
    pub longest: usize,
}

impl Traversal {
    pub fn new() -> Self {
        Self { index: [[0; LANES]; MAX_STEPS], quantity: [[0.0; LANES]; MAX_STEPS], steps: [0; LANES], longest: 0 }
    }

    /// Traverses `segments`.
    #[inline(always)]
    pub fn traverse(&mut self, segments: &SegmentLanes) {
        let mut state = DdaState::new(segments);
        self.steps = [0; LANES];
        self.longest = 0;
        while self.longest < MAX_STEPS {
            let (index, quantity) = (&mut self.index[self.longest], &mut self.quantity[self.longest]);
            let mut alive = 0u32;
            for lane in 0..LANES {
                index[lane] = state.index[lane] as u32 & state.last[lane];
                quantity[lane] = state.quantity[lane];
                self.steps[lane] += state.alive[lane] & 1;
                alive |= state.alive[lane];
            }
            if alive == 0 {
                break;
            }
            self.longest += 1;
            state.step();
        }
    }
}

/// The current voxels of sixteen segments.
struct DdaState {
    index: Lanes<i32>,
    /// Largest index of the block's array.
    last: Lanes<u32>,
    stride: [Lanes<i32>; 3],
    /// Parameter at which the next face is crossed, per axis, and difference between two crossings.
    next: [Lanes<f32>; 3],
    between: [Lanes<f32>; 3],
    quantity: Lanes<f32>,
    slope: [Lanes<f32>; 3],
    leave: Lanes<f32>,
    /// All bits set while the segment is in its block and within its interval.
    alive: Lanes<u32>,
}

impl DdaState {
    /// Starts where each segment enters its block or its interval, whichever is later.
    #[inline(always)]
    fn new(segments: &SegmentLanes) -> Self {
        let (mut point, mut inverse) = ([[0f32; LANES]; 3], [[0f32; LANES]; 3]);
        let (mut enter, mut leave) = (segments.enter, segments.leave);
        for k in 0..3 {
            for lane in 0..LANES {
                let p = (segments.point[k][lane] - segments.corner[k][lane]) * segments.per_voxel[lane];
                let d = segments.direction[k][lane];
                let i = 1.0 / if d.abs() < 1e-9 { 1e-9f32.copysign(d) } else { d };
                let (a, b) = (-p * i, (segments.edge[lane] as f32 - p) * i);
                let (near, far) = if a < b { (a, b) } else { (b, a) };
                enter[lane] = if near > enter[lane] { near } else { enter[lane] };
                leave[lane] = if far < leave[lane] { far } else { leave[lane] };
                point[k][lane] = p;
                inverse[k][lane] = i;
            }
        }
        let mut state = Self {
            index: [0; LANES],
            last: [0; LANES],
            stride: [[0; LANES]; 3],
            next: [[0.0; LANES]; 3],
            between: [[0.0; LANES]; 3],
            quantity: [0.0; LANES],
            slope: [[0.0; LANES]; 3],
            leave,
            alive: [0; LANES],
        };
        let mut stride = [1i32; LANES];
        for k in 0..3 {
            for lane in 0..LANES {
                let (direction, edge) = (segments.direction[k][lane], segments.edge[lane]);
                let at = point[k][lane] + enter[lane] * direction;
                // Not `clamp`, which would also handle NaN.
                let at = if at > 0.0 { at } else { 0.0 };
                let cell = floor_positive(if at < (edge - 1) as f32 { at } else { (edge - 1) as f32 });
                let ahead = direction > 0.0;
                state.index[lane] += cell * stride[lane];
                state.stride[k][lane] = if ahead { stride[lane] } else { -stride[lane] };
                state.next[k][lane] = ((cell + i32::from(ahead)) as f32 - point[k][lane]) * inverse[k][lane];
                state.between[k][lane] = inverse[k][lane].abs();
                state.slope[k][lane] = if ahead { segments.gradient[k][lane] } else { -segments.gradient[k][lane] };
                state.quantity[lane] += segments.gradient[k][lane] * (cell as f32 + 0.5 - point[k][lane]);
                stride[lane] *= edge;
            }
        }
        for lane in 0..LANES {
            state.last[lane] = (stride[lane] - 1) as u32;
            // Rounding must not carry the last step out of the block: a crossing this close to the end does not count.
            state.leave[lane] -= 1e-4;
            state.alive[lane] = mask(enter[lane] < state.leave[lane]);
        }
        state
    }

    /// Moves each segment across its nearest face.
    #[inline(always)]
    fn step(&mut self) {
        for lane in 0..LANES {
            let [a, b, c] = [self.next[0][lane], self.next[1][lane], self.next[2][lane]];
            // Not `min`, which would also handle NaN.
            let nearest = if a < b { a } else { b };
            let nearest = if nearest < c { nearest } else { c };
            let x = mask(a <= nearest);
            let y = mask(b <= nearest) & !x;
            let z = !(x | y);
            self.alive[lane] &= mask(nearest < self.leave[lane]);
            self.index[lane] += (self.stride[0][lane] & x as i32) + (self.stride[1][lane] & y as i32) + (self.stride[2][lane] & z as i32);
            self.quantity[lane] += select(self.slope[0][lane], x) + select(self.slope[1][lane], y) + select(self.slope[2][lane], z);
            self.next[0][lane] = a + select(self.between[0][lane], x);
            self.next[1][lane] = b + select(self.between[1][lane], y);
            self.next[2][lane] = c + select(self.between[2][lane], z);
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

    /// Voxels that contain one of many samples of a segment: the largest depth of a sample in the voxel, and the quantity at the centre.
    fn sampled(segment: &Segment) -> BTreeMap<usize, (f32, f32)> {
        let voxel = (1 << segment.scale) as f32;
        let edge = (BLOCK_EDGE >> segment.scale) as f32;
        let mut voxels = BTreeMap::new();
        for s in 0..=4000 {
            let t = segment.interval[0] + (segment.interval[1] - segment.interval[0]) * s as f32 / 4000.0;
            let at: [f32; 3] = std::array::from_fn(|k| (segment.point[k] - segment.corner[k]) / voxel + t * segment.direction[k]);
            if at.iter().all(|c| (0.0..edge).contains(c)) {
                let depth = at.iter().map(|c| (c - c.round()).abs()).fold(0.5, f32::min);
                let cell = at.map(|c| c as usize);
                let quantity = (0..3).map(|k| segment.gradient[k] * (cell[k] as f32 + 0.5 - (segment.point[k] - segment.corner[k]) / voxel)).sum();
                let best = voxels.entry(voxel_index(cell, segment.scale as usize)).or_insert((0f32, quantity));
                best.0 = best.0.max(depth);
            }
        }
        voxels
    }

    fn segment() -> impl Strategy<Value = Segment> {
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
                Segment { point, direction, gradient, corner, scale, interval: [from, to] }
            })
    }

    proptest! {
        #[test]
        fn segments_pass_the_voxels_that_contain_their_samples(segments in prop::collection::vec(segment(), 0..=LANES)) {
            let (mut batch, mut traversal) = (SegmentLanes::new(), Traversal::new());
            batch.clear();
            segments.iter().for_each(|segment| batch.push(segment));
            traversal.traverse(&batch);
            prop_assert!(traversal.steps[segments.len()..].iter().all(|&n| n == 0));
            for (lane, segment) in segments.iter().enumerate() {
                let slow = sampled(segment);
                let fast: BTreeMap<usize, f32> = (0..traversal.steps[lane] as usize).map(|s| (traversal.index[s][lane] as usize, traversal.quantity[s][lane])).collect();
                prop_assert_eq!(fast.len(), traversal.steps[lane] as usize, "a voxel is passed twice");
                for (voxel, (depth, quantity)) in &slow {
                    prop_assert!(fast.contains_key(voxel) || *depth < 2e-3, "missed {voxel}, {depth} deep");
                    prop_assert!(fast.get(voxel).is_none_or(|q| (q - quantity).abs() < 1e-3));
                }
                prop_assert!(fast.keys().filter(|v| !slow.contains_key(v)).count() <= 1 + fast.len() / 3, "{fast:?} {slow:?}");
            }
        }
    }
}
