//! Small worlds whose truth is plain to see, for tests.

use super::albedo;
use crate::WorldBuilder;
use crate::route::{Gait, Route};

/// A room of 10 x 8 x 3 m, open to nothing, with a crate, a pillar, a ball and a rail.
pub(super) fn room(b: &mut WorldBuilder) -> (Route, Gait) {
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
    (Route::rounded(&[], 1.5), Gait { height: 1.2, ..Gait::ROBOT })
}

/// Level ground and nothing else.
pub(super) fn plane(b: &mut WorldBuilder) -> (Route, Gait) {
    b.ground(0.0, albedo::PAVING);
    (Route::rounded(&[], 6.0), Gait::WALK)
}

/// A ball of 2 m radius about (0, 0, 2), and nothing else.
pub(super) fn sphere(b: &mut WorldBuilder) -> (Route, Gait) {
    b.sphere([0.0, 0.0, 2.0], 2.0, albedo::STONE);
    (Route::rounded(&[], 6.0), Gait::WALK)
}
