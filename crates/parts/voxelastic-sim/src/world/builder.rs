//! Construction of a world.

use super::World;
use super::union::Union;
use crate::SimError;
use crate::random::Stream;
use crate::solid::{Capsule, Cuboid, Cylinder, HalfSpace, Solid, Sphere, Vec3};

/// Collects solids for a [`World`].
#[derive(Clone, Debug)]
pub struct WorldBuilder {
    name: String,
    seed: u64,
    solids: Vec<(Solid, f32)>,
    /// Random numbers for the code that adds furniture.
    pub(crate) random: Stream,
}

impl WorldBuilder {
    /// An empty world.
    pub fn new(name: impl Into<String>, seed: u64) -> Self {
        Self { name: name.into(), seed, solids: Vec::new(), random: Stream::new(seed, &[]) }
    }

    /// Adds a solid with an albedo from 0 to 1.
    pub fn add(&mut self, solid: Solid, albedo: f32) {
        self.solids.push((solid, albedo.clamp(0.0, 1.0)));
    }

    /// Adds an axis-aligned box between two corners.
    pub fn cuboid(&mut self, a: [f64; 3], b: [f64; 3], albedo: f32) {
        self.add(Solid::Cuboid(Cuboid::between(a, b)), albedo);
    }

    /// Adds a box around `centre`, rotated about the vertical by `yaw` radians.
    pub fn turned(&mut self, centre: [f64; 3], size: [f64; 3], yaw: f64, albedo: f32) {
        self.add(Solid::Cuboid(Cuboid::turned(centre, size, yaw)), albedo);
    }

    /// Adds an upright cylinder that stands on `foot`.
    pub fn column(&mut self, foot: [f64; 3], height: f64, radius: f64, albedo: f32) {
        self.add(Solid::Cylinder(Cylinder::upright(foot, height, radius)), albedo);
    }

    /// Adds a cylinder between the centres of its ends.
    pub fn cylinder(&mut self, a: [f64; 3], b: [f64; 3], radius: f64, albedo: f32) {
        self.add(Solid::Cylinder(Cylinder::between(a, b, radius)), albedo);
    }

    /// Adds a sphere.
    pub fn sphere(&mut self, centre: [f64; 3], radius: f64, albedo: f32) {
        self.add(Solid::Sphere(Sphere::new(centre, radius)), albedo);
    }

    /// Adds a capsule: a cylinder with round ends.
    pub fn capsule(&mut self, a: [f64; 3], b: [f64; 3], radius: f64, albedo: f32) {
        self.add(Solid::Capsule(Capsule::between(a, b, radius)), albedo);
    }

    /// Adds level ground up to `height`.
    pub fn ground(&mut self, height: f64, albedo: f32) {
        self.add(Solid::HalfSpace(HalfSpace::below(height)), albedo);
    }

    /// Builds the world.
    ///
    /// # Errors
    /// [`SimError::Solid`] for a solid that is not finite or has a negative size.
    pub fn build(self) -> Result<World, SimError> {
        let is_valid = |solid: &Solid| {
            let (_, numbers) = solid.parameters();
            let size = match solid {
                Solid::Cuboid(b) => b.half,
                Solid::Cylinder(c) => Vec3::new(c.half_length, c.radius, 0.0),
                Solid::Capsule(c) => Vec3::new(c.half_length, c.radius, 0.0),
                Solid::Sphere(s) => Vec3::repeat(s.radius),
                Solid::HalfSpace(_) => Vec3::zeros(),
            };
            numbers.iter().all(|n| n.is_finite()) && size.min() >= 0.0
        };
        if let Some(index) = self.solids.iter().position(|(solid, _)| !is_valid(solid)) {
            return Err(SimError::Solid { index });
        }
        let (unbounded, bounded): (Vec<_>, Vec<_>) = self.solids.into_iter().partition(|(s, _)| matches!(s, Solid::HalfSpace(_)));
        let (bounded, albedos): (Vec<Solid>, Vec<f32>) = bounded.into_iter().unzip();
        let (union, order) = Union::new(&bounded, unbounded.iter().map(|(solid, _)| *solid));
        let albedo = order.iter().map(|&k| albedos[k as usize]).chain(unbounded.iter().map(|(_, albedo)| *albedo)).collect();
        Ok(World::new(self.name, self.seed, union, albedo))
    }
}
