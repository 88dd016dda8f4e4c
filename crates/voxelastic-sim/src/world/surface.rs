//! Points spread over the surface of a world.

use super::World;
use crate::random::Stream;
use crate::solid::Vec3;

/// A point of the surface of a world, map frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// The point.
    pub point: [f64; 3],
    /// Unit normal, out of the solid.
    pub normal: [f64; 3],
    /// The solid it lies on.
    pub solid: u32,
}

impl World {
    /// Points drawn at random, `density` to a square metre, from the surface of the union: what lies inside another solid
    /// is left out. Unbounded solids (the ground) give none; to cover what a sensor saw of them use
    /// [`crate::Simulation::visible_surface`]. The same for the same `seed`.
    pub fn sample_surface(&self, density: f64, seed: u64) -> Vec<SurfacePoint> {
        let mut points = Vec::new();
        for (index, solid) in (0u32..).zip(&self.solids[..self.bounded]) {
            let mut random = Stream::new(seed, &[0x5, u64::from(index)]);
            // A fraction of a point is a point by that chance, so that small solids get their share.
            let count = (solid.area() * density.max(0.0) + random.uniform()) as usize;
            for _ in 0..count {
                let p = solid.surface_point(random.uniform(), random.uniform(), random.uniform());
                if self.is_exposed(&p) {
                    points.push(SurfacePoint { point: p.into(), normal: solid.normal(&p).into(), solid: index });
                }
            }
        }
        points
    }

    /// Whether a point of a solid's surface is surface of the union, too.
    fn is_exposed(&self, p: &Vec3) -> bool {
        self.distance((*p).into()) > -1e-4
    }
}
