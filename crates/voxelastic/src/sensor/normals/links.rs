//! Which neighbouring pixels are on one surface: where the inverse depth has no jump against the trend.

use super::settings::LANES;
use crate::simd::{Kernel, larger, smaller};

/// A surface ends at differences against the trend of more than this many standard deviations of the range noise.
const JUMP_SIGMAS: f32 = 5.0;

/// The middle one of three.
#[inline(always)]
fn median(a: f32, b: f32, c: f32) -> f32 {
    larger(smaller(a, b), smaller(larger(a, b), c))
}

/// 1 if the step from `here` to `next` differs from the median of it and the steps before and after by no more than the noise.
///
/// On a plane the steps of the inverse depth are equal. At a crease they change once, and the middle one is still the median. Only at a jump the middle step differs
/// from both others.
#[inline(always)]
fn linked(here: f32, next: f32, steps: [f32; 3], noise: f32) -> f32 {
    let nearer = larger(here, next);
    let jump = (steps[1] - median(steps[0], steps[1], steps[2])).abs();
    let both = (here > 0.0) & (next > 0.0);
    if both & (jump <= JUMP_SIGMAS * noise * nearer * nearer) { 1.0 } else { 0.0 }
}

#[inline(always)]
fn step(from: f32, to: f32) -> f32 {
    if (from > 0.0) & (to > 0.0) { to - from } else { 0.0 }
}

/// Four pixels in line, of which the middle two may be linked: of six, of which the third is meant. Where it or the fourth is empty, those around the gap.
#[inline(always)]
fn around_gap<T: Copy>(six: [T; 6], is_empty: impl Fn(T) -> bool) -> [T; 4] {
    let [a, b, c, d, e, f] = six;
    let (no_here, no_next) = (is_empty(c), is_empty(d));
    let pick = |direct: T, over_next: T, over_this: T| {
        let beyond = if no_next { over_next } else { direct };
        if no_here { over_this } else { beyond }
    };
    [pick(b, b, a), pick(c, c, b), pick(d, e, d), pick(e, f, e)]
}

/// The links of pixels to the next ones in their row.
pub(super) struct LinkRight<'a> {
    /// The columns from two before to three after those of the links.
    pub(super) inverse: [&'a [f32]; 6],
    pub(super) noise: f32,
    pub(super) link: &'a mut [f32],
}

impl Kernel for LinkRight<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { inverse, noise, link } = self;
        let [a, b, c, d, e, f] = inverse.map(|w| &w[..link.len()]);
        for i in 0..link.len() {
            let [before, here, next, after] = around_gap([a[i], b[i], c[i], d[i], e[i], f[i]], |w| w == 0.0);
            // Over a gap the middle step is as long as two.
            let length = if (c[i] == 0.0) | (d[i] == 0.0) { 2.0 } else { 1.0 };
            link[i] = linked(here, next, [length * step(before, here), step(here, next), length * step(next, after)], noise);
        }
    }
}

/// The links of pixels to those below them.
pub(super) struct LinkDown<'a> {
    /// The rows from two above to three below.
    pub(super) inverse: [&'a [f32]; 6],
    pub(super) rise: [&'a [f32]; 6],
    pub(super) noise: f32,
    /// In whole strips.
    pub(super) link: &'a mut [f32],
}

impl<'a> Kernel for LinkDown<'a> {
    #[inline(always)]
    fn run(self) {
        let noise = self.noise;
        for (strip, link) in self.link.chunks_exact_mut(LANES).enumerate() {
            let chunk = |row: usize, planes: &[&'a [f32]; 6]| planes[row][strip * LANES..].first_chunk::<LANES>();
            let six =
                |planes| Some([chunk(0, planes)?, chunk(1, planes)?, chunk(2, planes)?, chunk(3, planes)?, chunk(4, planes)?, chunk(5, planes)?]);
            let (Some(w), Some(t)) = (six(&self.inverse), six(&self.rise)) else { return };
            // A local copy: it cannot alias the inputs, so the loop is vectorised.
            let mut links = [0f32; LANES];
            for i in 0..LANES {
                links[i] = linked_down(around_gap([0, 1, 2, 3, 4, 5].map(|k| (w[k][i], t[k][i])), |(w, _)| w == 0.0), noise);
            }
            link.copy_from_slice(&links);
        }
    }
}

/// As [`linked`], for rows that are not evenly spaced: four pairs of inverse depth and rise, of which the middle two may be linked.
#[inline(always)]
fn linked_down([before, here, next, after]: [(f32, f32); 4], noise: f32) -> f32 {
    /// Rows that noise has brought closer than this are not divided by.
    const LEAST_FALL: f32 = 1e-4;
    let fall = |a: (f32, f32), b: (f32, f32)| larger(a.1 - b.1, LEAST_FALL);
    let middle = fall(here, next);
    let steps = [step(before.0, here.0) * (middle / fall(before, here)), step(here.0, next.0), step(next.0, after.0) * (middle / fall(next, after))];
    linked(here.0, next.0, steps, noise)
}

/// The inverse depths of a row at the centres of their pixels.
pub(super) struct Centre<'a> {
    pub(super) before: &'a [f32],
    pub(super) here: &'a [f32],
    pub(super) after: &'a [f32],
    /// How far the points are off the centres, as tangents.
    pub(super) across: &'a [f32],
    /// 1 / (signed angle between columns).
    pub(super) per_step: f32,
    pub(super) centred: &'a mut [f32],
}

impl Kernel for Centre<'_> {
    /// Interpolates each inverse depth to its pixel's centre by the smaller of the slopes to both sides.
    #[inline(always)]
    fn run(self) {
        let Self { before, here, after, across, per_step, centred } = self;
        let count = centred.len();
        let (before, here, after, across) = (&before[..count], &here[..count], &after[..count], &across[..count]);
        for i in 0..count {
            let (left, right) = (step(before[i], here[i]), step(here[i], after[i]));
            let gentle = median(left, right, 0.0) * per_step;
            centred[i] = larger(here[i] - gentle * across[i], 0.0);
        }
    }
}
