//! Random states for the search trees.

use crate::points::{Point, between, distance};
use crate::space::Space;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

/// Draws after which a sample without a valid state is given up.
const MAX_DRAWS: usize = 64;
/// The same for the bridge test, whose draws are cheap and mostly fail.
const MAX_BRIDGE_DRAWS: usize = 100;
/// Scales of the bridges, metres: doorways, corridors, tunnels.
const BRIDGE_SCALES: [f64; 3] = [1.2, 2.5, 5.0];

/// Draws random states; the same ones for the same seed.
pub(crate) struct Sampler<'a, S> {
    space: &'a S,
    random: StdRng,
    /// Corners of the box to draw from.
    region: [Point; 2],
    /// Only states in the ellipsoid with these foci and this sum of distances are drawn, metres.
    ellipsoid: Option<([Point; 2], f64)>,
    /// Samples counted so far.
    pub(crate) drawn: usize,
}

impl<'a, S: Space> Sampler<'a, S> {
    /// Draws from the bounds of a space.
    pub(crate) fn new(space: &'a S, seed: u64) -> Self {
        Self { space, random: StdRng::seed_from_u64(seed), region: space.bounds(), ellipsoid: None, drawn: 0 }
    }

    /// An independent sampler of the same space, seeded by this one.
    pub(crate) fn fork(&mut self) -> Self {
        Self::new(self.space, self.random.random())
    }

    /// Restricts samples to states over which a path between `foci` can be shorter than `max_length` metres.
    pub(crate) fn restrict_to_ellipsoid(&mut self, foci: [Point; 2], max_length: f64) {
        self.ellipsoid = Some((foci, max_length));
        let bounds = self.space.bounds();
        // The box around the ellipsoid. On the ground height is not sampled but follows the floor, so the box has to hold all heights of the ellipsoid.
        let straight = self.space.metric(foci[0], foci[1]);
        let (long, short) = (0.5 * max_length, 0.5 * (max_length * max_length - straight * straight).max(0.0).sqrt());
        let half_extent = |k: usize| {
            let along = (foci[1][k] - foci[0][k]) / straight.max(1e-9);
            let is_free = self.space.dimensions() == 3 || k < 2;
            if is_free { (long * along).hypot(short * (1.0 - along * along).max(0.0).sqrt()) } else { short + 0.5 * (foci[1][k] - foci[0][k]).abs() }
        };
        let middle = between(foci[0], foci[1], 0.5);
        self.region = [
            std::array::from_fn(|k| bounds[0][k].max(middle[k] - half_extent(k))),
            std::array::from_fn(|k| bounds[1][k].min(middle[k] + half_extent(k))),
        ];
    }

    fn is_in_ellipsoid(&self, p: Point) -> bool {
        let off = |q| self.space.metric(p, q);
        self.ellipsoid.is_none_or(|(foci, max_length)| off(foci[0]) + off(foci[1]) < max_length)
    }

    /// A uniform number in 0..1.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.random.random()
    }

    /// A uniform index below `end`, which must not be 0; counts as a sample.
    pub(crate) fn index_below(&mut self, end: usize) -> usize {
        self.drawn += 1;
        self.random.random_range(0..end)
    }

    fn point(&mut self) -> Point {
        let [low, high] = self.region;
        std::array::from_fn(|k| low[k] + self.random.random::<f64>() * (high[k] - low[k]))
    }

    /// A random offset, about normally distributed with a standard deviation of 0.6 times `scale` per axis.
    fn offset(&mut self, scale: f64) -> Point {
        let flat = self.space.dimensions() == 2;
        std::array::from_fn(|k| {
            // The sum of three is close enough to a normal distribution.
            let normal: f64 = (0..3).map(|_| self.random.random::<f64>() - 0.5).sum();
            if flat && k == 2 { 0.0 } else { normal * 1.2 * scale }
        })
    }

    /// A state drawn uniformly.
    pub(crate) fn uniform_state(&mut self) -> Option<Point> {
        self.drawn += 1;
        (0..MAX_DRAWS).find_map(|_| {
            let p = self.point();
            if self.is_in_ellipsoid(p) { self.space.state_at(p) } else { None }
        })
    }

    /// A state midway between two blocked points, which is probably in a doorway (the bridge test of Hsu and others, 2003).
    pub(crate) fn bridge_state(&mut self) -> Option<Point> {
        self.drawn += 1;
        (0..MAX_BRIDGE_DRAWS).find_map(|_| {
            let p = self.point();
            if !self.is_in_ellipsoid(p) {
                return None;
            }
            let scale = BRIDGE_SCALES[self.random.random_range(0..BRIDGE_SCALES.len())];
            let mut by = self.offset(scale);
            // Most narrow passages are bounded by vertical walls.
            by[2] = if self.random.random() { 0.0 } else { by[2] };
            let q = std::array::from_fn(|k| p[k] + by[k]);
            let is_bridge = self.space.is_blocked(p) && self.space.is_blocked(q);
            if is_bridge { self.space.state_at(between(p, q, 0.5)) } else { None }
        })
    }

    /// A state near a path.
    pub(crate) fn state_near(&mut self, path: &[Point], scale: f64) -> Option<Point> {
        self.drawn += 1;
        let length: f64 = crate::points::length(path);
        let mut remaining = self.uniform() * length;
        let segment = path.windows(2).find(|w| {
            remaining -= distance(w[0], w[1]);
            remaining <= 0.0
        })?;
        let on = between(segment[1], segment[0], (-remaining / distance(segment[0], segment[1]).max(1e-9)).min(1.0));
        let by = self.offset(scale);
        self.space.state_at(std::array::from_fn(|k| on[k] + by[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::distance;
    use proptest::prelude::*;

    /// Space without obstacles, of 2 or 3 dimensions.
    struct Empty(usize);

    impl Space for Empty {
        fn steer(&self, _: Point, to: Point) -> Option<Point> {
            Some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
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
        fn region_contains_every_path_that_is_short_enough(
            foci in prop::array::uniform2(prop::array::uniform3(-9.0..9.0f64)), p in prop::array::uniform3(-15.0..15.0f64), more in 0.0..9.0f64, flat in any::<bool>(),
        ) {
            let space = Empty(if flat { 2 } else { 3 });
            let mut sampler = Sampler::new(&space, 1);
            let max_length = distance(foci[0], foci[1]) + more;
            sampler.restrict_to_ellipsoid(foci, max_length);
            let [low, high] = sampler.region;
            let is_short = distance(foci[0], p) + distance(p, foci[1]) < max_length;
            prop_assert!(!is_short || (0..3).all(|k| p[k] >= low[k] - 1e-9 && p[k] <= high[k] + 1e-9), "{:?}", sampler.region);
            let drawn = sampler.uniform_state();
            prop_assert!(drawn.is_none_or(|p| sampler.is_in_ellipsoid(p)));
        }
    }
}
