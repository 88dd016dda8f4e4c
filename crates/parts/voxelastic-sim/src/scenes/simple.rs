//! Small worlds for tests.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Carrier, Route};

/// A closed room of 10 x 8 x 3 m with a crate, a pillar, a sphere and a rail.
pub(super) fn room(b: &mut WorldBuilder) -> (Route, Carrier) {
    let (x, y, z) = (5.0, 4.0, 3.0);
    b.cuboid([-x - 1.0, -y - 1.0, -1.0], [x + 1.0, y + 1.0, 0.0], albedo::WOOD);
    b.cuboid([-x - 1.0, -y - 1.0, z], [x + 1.0, y + 1.0, z + 1.0], albedo::PAINT);
    b.cuboid([-x - 1.0, -y - 1.0, -1.0], [-x, y + 1.0, z + 1.0], albedo::PAINT);
    b.cuboid([x, -y - 1.0, -1.0], [x + 1.0, y + 1.0, z + 1.0], albedo::PAINT);
    b.cuboid([-x - 1.0, -y - 1.0, -1.0], [x + 1.0, -y, z + 1.0], albedo::PAINT);
    b.cuboid([-x - 1.0, y, -1.0], [x + 1.0, y + 1.0, z + 1.0], albedo::PAINT);
    b.turned([3.4, 2.6, 0.5], [1.2, 0.8, 1.0], 0.4, albedo::WOOD);
    b.column([-3.6, 2.7, 0.0], 3.0, 0.2, albedo::STONE);
    b.sphere([3.5, -2.8, 0.6], 0.6, albedo::STONE);
    b.capsule([-4.2, -3.2, 0.9], [-1.5, -3.6, 0.9], 0.03, albedo::IRON);
    (Route::rounded(&[], 1.5), Carrier { height: 1.2, ..Carrier::ROBOT })
}

/// Level ground and nothing else.
pub(super) fn plane(b: &mut WorldBuilder) -> (Route, Carrier) {
    b.ground(0.0, albedo::PAVING);
    (Route::rounded(&[], 6.0), Carrier::PEDESTRIAN)
}

/// A sphere of 2 m radius around (0, 0, 2), and nothing else.
pub(super) fn sphere(b: &mut WorldBuilder) -> (Route, Carrier) {
    b.sphere([0.0, 0.0, 2.0], 2.0, albedo::STONE);
    (Route::rounded(&[], 6.0), Carrier::PEDESTRIAN)
}
