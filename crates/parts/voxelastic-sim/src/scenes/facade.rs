//! Facades: piers, bands, window recesses, pilasters and a cornice in front of a plain block.

use super::albedo;
use crate::WorldBuilder;

/// Depth of the windows behind the front, metres: the block behind the front must start here.
pub(super) const RECESS: f64 = 0.3;

/// A straight front. The street or court is to the left of the direction from `from` to `to`.
#[derive(Clone, Debug)]
pub(super) struct Facade {
    /// Ends of the front, metres; it must be parallel to an axis.
    pub from: [f64; 2],
    pub to: [f64; 2],
    /// Height of the cornice, metres.
    pub height: f64,
    /// Rows of windows.
    pub storeys: usize,
    /// Width of a window with its share of the piers, metres.
    pub bay: f64,
    /// Depth of the pilasters at every second pier, metres; 0 for none.
    pub pilasters: f64,
    /// Doors and gates: start and end along the front, and height, metres.
    pub gates: Vec<[f64; 3]>,
}

/// A part of a front: extent along it, out of it (to the left) and up.
#[derive(Clone, Copy)]
struct Part {
    along: [f64; 2],
    out: [f64; 2],
    up: [f64; 2],
    albedo: f32,
}

impl Facade {
    /// Adds the front to a world.
    pub(super) fn add(&self, b: &mut WorldBuilder) {
        let length = (self.to[0] - self.from[0]).hypot(self.to[1] - self.from[1]);
        let bays = ((length / self.bay).round() as usize).max(1);
        let bay = length / bays as f64;
        self.bands(b, length);
        for k in 0..=bays {
            let middle = (k as f64 * bay).clamp(0.0, length);
            let pier = [(middle - 0.24 * bay).max(0.0), (middle + 0.24 * bay).min(length)];
            self.put(b, Part { along: pier, out: [-RECESS - 0.1, 0.0], up: [0.0, self.height], albedo: albedo::STONE }, 0);
            if self.pilasters > 0.0 && k % 2 == 0 {
                self.pilaster(b, middle.clamp(0.35, length - 0.35));
            }
            if k < bays {
                let bar = middle + 0.5 * bay;
                let part =
                    Part { along: [bar - 0.04, bar + 0.04], out: [-RECESS - 0.1, -0.5 * RECESS], up: [0.5, self.height], albedo: albedo::TRIM };
                self.put(b, part, 0);
            }
        }
    }

    /// Plinth, the wall between rows of windows, and cornice.
    fn bands(&self, b: &mut WorldBuilder, length: f64) {
        let storey = self.height / self.storeys.max(1) as f64;
        let along = [0.0, length];
        let mut below = 0.0;
        for k in 0..self.storeys.max(1) {
            let sill = k as f64 * storey + if k == 0 { 0.9 } else { 0.7 };
            let out = if k == 0 { 0.06 } else { 0.0 };
            self.put(b, Part { along, out: [-RECESS - 0.1, out], up: [below, sill], albedo: albedo::STONE }, 0);
            self.put(b, Part { along, out: [-RECESS - 0.1, 0.1], up: [sill - 0.1, sill], albedo: albedo::TRIM }, 0);
            below = (k + 1) as f64 * storey - 0.6;
        }
        self.put(b, Part { along, out: [-RECESS - 0.1, 0.0], up: [below, self.height], albedo: albedo::STONE }, 0);
        self.put(b, Part { along, out: [-RECESS - 0.1, 0.35], up: [self.height - 0.3, self.height + 0.1], albedo: albedo::TRIM }, 0);
    }

    fn pilaster(&self, b: &mut WorldBuilder, middle: f64) {
        let parts = [(0.3, 1.0, 0.0, self.height - 0.2), (0.42, 1.5, 0.0, 0.7), (0.42, 1.5, self.height - 1.0, self.height - 0.6)];
        for (half, stand, low, high) in parts {
            let part = Part { along: [middle - half, middle + half], out: [-0.1, self.pilasters * stand], up: [low, high], albedo: albedo::TRIM };
            self.put(b, part, 0);
        }
    }

    /// Adds a part without its intersection with the gates from index `gate` on.
    fn put(&self, b: &mut WorldBuilder, part: Part, gate: usize) {
        let Some(&[start, end, top]) = self.gates.get(gate) else { return self.solid(b, &part) };
        if part.along[1] <= start || part.along[0] >= end || part.up[0] >= top {
            return self.put(b, part, gate + 1);
        }
        if part.along[0] < start {
            self.put(b, Part { along: [part.along[0], start], ..part }, gate + 1);
        }
        if part.along[1] > end {
            self.put(b, Part { along: [end, part.along[1]], ..part }, gate + 1);
        }
        if part.up[1] > top {
            self.put(b, Part { up: [top, part.up[1]], ..part }, gate + 1);
        }
    }

    fn solid(&self, b: &mut WorldBuilder, part: &Part) {
        let (dx, dy) = (self.to[0] - self.from[0], self.to[1] - self.from[1]);
        let length = dx.hypot(dy).max(1e-9);
        let (u, v) = ([dx / length, dy / length], [-dy / length, dx / length]);
        let corner = |along: f64, out: f64, up: f64| [self.from[0] + u[0] * along + v[0] * out, self.from[1] + u[1] * along + v[1] * out, up];
        b.cuboid(corner(part.along[0], part.out[0], part.up[0]), corner(part.along[1], part.out[1], part.up[1]), part.albedo);
    }
}

/// A block of masonry from the ground up, set back by the recess on all sides, to be placed behind facades on its outline.
pub(super) fn mass(b: &mut WorldBuilder, low: [f64; 2], high: [f64; 2], height: f64) {
    b.cuboid([low[0] + RECESS, low[1] + RECESS, -0.5], [high[0] - RECESS, high[1] - RECESS, height], albedo::GLASS);
}
