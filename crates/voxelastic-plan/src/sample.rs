//! Where to try next.

use crate::connect::flat_distance;
use crate::points::{Point, between, distance};
use crate::space::Space;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Draws in a row that may miss before a sampler gives up on this turn.
const PATIENCE: usize = 64;
/// The same for bridges: most draws miss, at little cost.
const PATIENCE_FOR_BRIDGES: usize = 100;
/// Widest gaps that bridges span, metres: doorways, corridors, tunnels.
const BRIDGES: [f64; 3] = [1.2, 2.5, 5.0];

/// Draws states at random: the same ones for the same seed.
pub(crate) struct Sampler<'a, S> {
    space: &'a S,
    random: StdRng,
    /// Corners of the box to draw from.
    region: [Point; 2],
    /// Only places over which the way between these two is shorter than this are of use.
    within: Option<([Point; 2], f64)>,
    /// States drawn or given up on.
    pub(crate) drawn: usize,
}

impl<'a, S: Space> Sampler<'a, S> {
    pub(crate) fn new(space: &'a S, seed: u64) -> Self {
        Self { space, random: StdRng::seed_from_u64(seed), region: space.bounds(), within: None, drawn: 0 }
    }

    /// Another one, for a part of the work.
    pub(crate) fn child(&mut self) -> Self {
        Self::new(self.space, self.random.random())
    }

    /// From now on draws nothing over which the way between two places is longer than `longest`.
    pub(crate) fn keep_within(&mut self, ends: [Point; 2], longest: f64) {
        self.within = Some((ends, longest));
        let bounds = self.space.bounds();
        // The box around the ellipsoid; where the floor leads up and down is not chosen, so it may go there as well.
        let straight = flat_distance(self.space, ends[0], ends[1]);
        let (long, short) = (0.5 * longest, 0.5 * (longest * longest - straight * straight).max(0.0).sqrt());
        let reach = |k: usize| {
            let along = (ends[1][k] - ends[0][k]) / straight.max(1e-9);
            let is_free = self.space.dimensions() == 3 || k < 2;
            if is_free { (long * along).hypot(short * (1.0 - along * along).max(0.0).sqrt()) } else { short + 0.5 * (ends[1][k] - ends[0][k]).abs() }
        };
        let middle = between(ends[0], ends[1], 0.5);
        self.region =
            [std::array::from_fn(|k| bounds[0][k].max(middle[k] - reach(k))), std::array::from_fn(|k| bounds[1][k].min(middle[k] + reach(k)))];
    }

    fn is_within(&self, p: Point) -> bool {
        let off = |q| flat_distance(self.space, p, q);
        self.within.is_none_or(|(ends, longest)| off(ends[0]) + off(ends[1]) < longest)
    }

    /// A number from 0 to 1.
    pub(crate) fn share(&mut self) -> f64 {
        self.random.random()
    }

    /// A number below `end`, which is not 0; it counts as a sample.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        self.drawn += 1;
        self.random.random_range(0..end)
    }

    fn place(&mut self) -> Point {
        let [low, high] = self.region;
        std::array::from_fn(|k| low[k] + self.random.random::<f64>() * (high[k] - low[k]))
    }

    /// A step in any direction, of a length that is most often short against `reach`.
    fn step(&mut self, reach: f64) -> Point {
        let flat = self.space.dimensions() == 2;
        std::array::from_fn(|k| {
            // The sum of three is close enough to a normal distribution.
            let normal: f64 = (0..3).map(|_| self.random.random::<f64>() - 0.5).sum();
            if flat && k == 2 { 0.0 } else { normal * 1.2 * reach }
        })
    }

    /// A state anywhere.
    pub(crate) fn anywhere(&mut self) -> Option<Point> {
        self.drawn += 1;
        (0..PATIENCE).find_map(|_| {
            let p = self.place();
            if self.is_within(p) { self.space.settle(p) } else { None }
        })
    }

    /// A state between two places that are blocked: in a doorway, most likely (the bridge test of Hsu and others,
    /// 2003).
    pub(crate) fn bridge(&mut self) -> Option<Point> {
        self.drawn += 1;
        (0..PATIENCE_FOR_BRIDGES).find_map(|_| {
            let p = self.place();
            if !self.is_within(p) {
                return None;
            }
            let reach = BRIDGES[self.random.random_range(0..BRIDGES.len())];
            let mut by = self.step(reach);
            // Most of what is narrow stands upright.
            by[2] = if self.random.random() { 0.0 } else { by[2] };
            let q = std::array::from_fn(|k| p[k] + by[k]);
            let is_bridge = self.space.is_blocked(p) && self.space.is_blocked(q);
            if is_bridge { self.space.settle(between(p, q, 0.5)) } else { None }
        })
    }

    /// A state near a line.
    pub(crate) fn near(&mut self, line: &[Point], reach: f64) -> Option<Point> {
        self.drawn += 1;
        let all: f64 = crate::points::length(line);
        let mut left = self.share() * all;
        let piece = line.windows(2).find(|w| {
            left -= distance(w[0], w[1]);
            left <= 0.0
        })?;
        let on = between(piece[1], piece[0], (-left / distance(piece[0], piece[1]).max(1e-9)).min(1.0));
        let by = self.step(reach);
        self.space.settle(std::array::from_fn(|k| on[k] + by[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::distance;
    use proptest::prelude::*;

    /// Everything, in the air or on the ground.
    struct Empty(usize);

    impl Space for Empty {
        fn reach(&self, _: Point, to: Point) -> Option<Point> {
            Some(to)
        }

        fn settle(&self, p: Point) -> Option<Point> {
            Some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-50.0; 3], [50.0; 3]]
        }

        fn dimensions(&self) -> usize {
            self.0
        }
    }

    proptest! {
        #[test]
        fn the_region_holds_every_way_that_is_short_enough(
            ends in prop::array::uniform2(prop::array::uniform3(-9.0..9.0f64)), p in prop::array::uniform3(-15.0..15.0f64), more in 0.0..9.0f64, flat in any::<bool>(),
        ) {
            let space = Empty(if flat { 2 } else { 3 });
            let mut sampler = Sampler::new(&space, 1);
            let longest = distance(ends[0], ends[1]) + more;
            sampler.keep_within(ends, longest);
            let [low, high] = sampler.region;
            let is_short = distance(ends[0], p) + distance(p, ends[1]) < longest;
            prop_assert!(!is_short || (0..3).all(|k| p[k] >= low[k] - 1e-9 && p[k] <= high[k] + 1e-9), "{:?}", sampler.region);
            let drawn = sampler.anywhere();
            prop_assert!(drawn.is_none_or(|p| sampler.is_within(p)));
        }
    }
}
