//! Sampling of the surface of a world.

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
    /// Random points on the surface of the union, `density` per square metre; faces inside of other solids are left out. Unbounded solids (the ground)
    /// are not sampled; for the part that a sensor saw use [`crate::Simulation::visible_surface`]. Deterministic for a `seed`.
    pub fn sample_surface(&self, density: f64, seed: u64) -> Vec<SurfacePoint> {
        let mut points = Vec::new();
        for (index, solid) in (0u32..).zip(self.bounded_solids()) {
            let mut random = Stream::new(seed, &[0x5, u64::from(index)]);
            // The fraction of a point is rounded up with that probability, so that small solids are sampled, too.
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

    /// Whether a point of a solid's surface is on the surface of the union.
    fn is_exposed(&self, p: &Vec3) -> bool {
        self.distance((*p).into()) > -1e-4
    }
}
