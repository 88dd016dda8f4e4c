//! The worlds that come with the crate, each with a route through it.

mod campus;
mod facade;
mod furniture;
mod mine;
mod plan;
mod simple;
mod street;

use crate::route::{Gait, Ride, Route};
use crate::{SimError, World, WorldBuilder};

/// A world and a ride through it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The world.
    pub world: World,
    /// Where the sensor goes in it, and how.
    pub ride: Ride,
    /// Scans that show the whole of it, 2 m apart, and come back to places seen before.
    pub usual_scans: usize,
}

/// How much light surfaces throw back.
pub(crate) mod albedo {
    pub(crate) const STONE: f32 = 0.42;
    pub(crate) const TRIM: f32 = 0.6;
    pub(crate) const GLASS: f32 = 0.12;
    pub(crate) const ROCK: f32 = 0.25;
    pub(crate) const GRASS: f32 = 0.3;
    pub(crate) const PAVING: f32 = 0.22;
    pub(crate) const BARK: f32 = 0.2;
    pub(crate) const LEAVES: f32 = 0.35;
    pub(crate) const IRON: f32 = 0.15;
    pub(crate) const WOOD: f32 = 0.3;
    pub(crate) const PAINT: f32 = 0.7;
    pub(crate) const SIGN: f32 = 0.95;
}

/// Furnishes a world: its solids go into the builder.
type Furnish = fn(&mut WorldBuilder) -> (Route, Gait);

const SCENES: [(&str, usize, Furnish); 6] = [
    ("campus", 210, campus::furnish),
    ("mine", 210, mine::furnish),
    ("street", 400, street::furnish),
    ("room", 20, simple::room),
    ("plane", 20, simple::plane),
    ("sphere", 20, simple::sphere),
];

/// Names of the worlds: `campus` (a college quad, a tunnel, a park and a 1 m doorway), `mine` (rooms and corridors hewn from
/// rock), `street` (a block of houses), and the small `room`, `plane` and `sphere` for tests.
pub fn names() -> impl Iterator<Item = &'static str> {
    SCENES.iter().map(|s| s.0)
}

impl Scene {
    /// The scene called `name` (see [`names`]). What is random in it follows from `seed`; the same on every machine.
    ///
    /// # Errors
    /// [`SimError::UnknownWorld`], with the names that exist.
    pub fn named(name: &str, seed: u64) -> Result<Self, SimError> {
        let found = SCENES.iter().find(|s| s.0 == name);
        let &(name, usual_scans, furnish) =
            found.ok_or_else(|| SimError::UnknownWorld { name: name.into(), known: names().collect::<Vec<_>>().join(", ") })?;
        let mut builder = WorldBuilder::new(name, seed);
        let (route, gait) = furnish(&mut builder);
        Ok(Self { world: builder.build()?, ride: Ride { route, gait }, usual_scans })
    }
}

impl World {
    /// The world called `name`, as [`Scene::named`].
    ///
    /// # Errors
    /// [`SimError::UnknownWorld`], with the names that exist.
    pub fn named(name: &str, seed: u64) -> Result<Self, SimError> {
        Scene::named(name, seed).map(|scene| scene.world)
    }
}

/// Free space around a planned route, to keep furniture out of the way.
pub(crate) fn off_route(route: &Route, p: [f64; 2], clearance: f64) -> bool {
    let steps = (route.length() / 0.5) as usize;
    (0..steps).all(|k| {
        let q = route.at(k as f64 * 0.5).0;
        (p[0] - q[0]).hypot(p[1] - q[1]) > clearance
    })
}

#[cfg(test)]
mod tests;
