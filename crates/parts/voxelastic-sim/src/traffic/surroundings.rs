//! A world with what moves in it.

use super::body::{Body, Traffic};
use super::label::Label;
use crate::solid::Vec3;
use crate::{Ray, World};

/// What a sensor sees: a world, and the traffic in it.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// What stands.
    pub world: &'a World,
    /// What moves.
    pub traffic: &'a [Body],
    /// Time at the beginning of the sweep, seconds.
    pub time: f64,
}

impl<'a> From<&'a World> for Surroundings<'a> {
    fn from(world: &'a World) -> Self {
        Self { world, traffic: &[], time: 0.0 }
    }
}

impl Traffic {
    /// A world with this traffic, for a sweep that begins at a time in seconds.
    pub fn within<'a>(&'a self, world: &'a World, time: f64) -> Surroundings<'a> {
        Surroundings { world, traffic: &self.bodies, time }
    }
}

/// A body where it is at one time.
pub(crate) struct BodyPose<'a> {
    shape: &'a World,
    position: [f64; 2],
    cos: f64,
    sin: f64,
    /// Middle of a ball around it, world frame, and its squared radius.
    middle: Vec3,
    square: f64,
    /// What its points are labelled.
    pub label: Label,
}

impl<'a> Surroundings<'a> {
    /// All bodies `offset` seconds after the beginning of the sweep.
    pub(crate) fn bodies_at(&self, offset: f64) -> Vec<BodyPose<'a>> {
        let pose = |body: &'a Body| {
            let (position, heading) = body.at(self.time + offset);
            let (low, high) = body.shape.bounds()?;
            let corner = Vec3::new(low[0].abs().max(high[0].abs()), low[1].abs().max(high[1].abs()), 0.5 * (high[2] - low[2]));
            let middle = Vec3::new(position[0], position[1], 0.5 * (low[2] + high[2]));
            let (sin, cos) = heading.sin_cos();
            let label = body.label(self.time + offset);
            Some(BodyPose { shape: &body.shape, position, cos, sin, middle, square: corner.norm_squared(), label })
        };
        self.traffic.iter().filter_map(pose).collect()
    }
}

impl BodyPose<'_> {
    /// Range, normal, albedo and solid of the first surface along a ray that is nearer than `limit` metres, world frame.
    pub(crate) fn cast(&self, (origin, direction): &Ray, limit: f64) -> Option<(f64, Vec3, f32, u32)> {
        let to = self.middle - origin;
        let along = to.dot(direction);
        if to.norm_squared() - along * along > self.square || along < -self.square.sqrt() {
            return None;
        }
        let inwards = |v: Vec3| Vec3::new(self.cos * v.x + self.sin * v.y, self.cos * v.y - self.sin * v.x, v.z);
        let local = inwards(origin - Vec3::new(self.position[0], self.position[1], 0.0));
        let towards = inwards(*direction);
        let hit = self.shape.cast(local.into(), towards.into(), limit)?;
        let n = self.shape.normal(hit.solid, (local + towards * hit.range).into());
        let normal = Vec3::new(self.cos * n[0] - self.sin * n[1], self.cos * n[1] + self.sin * n[0], n[2]);
        (hit.range < limit).then(|| (hit.range, normal, self.shape.albedo(hit.solid), hit.solid))
    }
}
