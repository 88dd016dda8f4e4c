//! The built-in worlds, each with a route through it.

mod albedo;
mod campus;
mod district;
mod facade;
mod floor_plan;
mod furniture;
mod house;
mod maze;
mod mine;
mod simple;
mod street;
mod tunnel;
mod yard;

use crate::route::{Carrier, Route, Trajectory};
use crate::{SimError, World, WorldBuilder};

/// A world and a trajectory through it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The world.
    pub world: World,
    /// The sensor's motion.
    pub trajectory: Trajectory,
    /// Number of scans, 2 m apart, that cover the world and revisit parts of it.
    pub default_scans: usize,
}

/// Adds the solids of a world to a builder.
type Build = fn(&mut WorldBuilder) -> (Route, Carrier);

/// Name, default number of scans and construction of each world.
const SCENES: [(&str, usize, Build); 11] = [
    ("campus", 210, campus::build),
    ("mine", 210, mine::build),
    ("street", 400, street::build),
    ("tunnel", 400, tunnel::build),
    ("maze", 20, maze::build),
    ("district", 400, district::build),
    ("house", 100, house::build),
    ("yard", 60, yard::build),
    ("room", 20, simple::room),
    ("plane", 20, simple::plane),
    ("sphere", 20, simple::sphere),
];

/// Names of the worlds: `campus` (a college quad, a tunnel, a park and a 1 m doorway), `mine` (rooms and corridors hewn from
/// rock), `street` (a block of houses), `tunnel` (300 m without
/// features), `maze` (corridors with dead ends, to explore), `district` (a square kilometre of streets, houses, yards and parks, to explore), `house`
/// (two storeys with stairs), `yard` (ramps, a kerb, a table and low obstacles), and the small `room`,
/// `plane` and `sphere` for tests.
pub fn names() -> impl Iterator<Item = &'static str> {
    SCENES.iter().map(|s| s.0)
}

impl Scene {
    /// The scene called `name` (see [`names`]). Its random details depend on `seed` only and are the same on every machine.
    ///
    /// # Errors
    /// [`SimError::UnknownWorld`], with the names that exist.
    pub fn named(name: &str, seed: u64) -> Result<Self, SimError> {
        let found = SCENES.iter().find(|s| s.0 == name);
        let &(name, default_scans, build) =
            found.ok_or_else(|| SimError::UnknownWorld { name: name.into(), known: names().collect::<Vec<_>>().join(", ") })?;
        let mut builder = WorldBuilder::new(name, seed);
        let (route, carrier) = build(&mut builder);
        Ok(Self { world: builder.build()?, trajectory: Trajectory { route, carrier, rest: 0.0 }, default_scans })
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

#[cfg(test)]
mod tests;
