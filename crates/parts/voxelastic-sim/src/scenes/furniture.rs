//! Furniture: trees, railings, lamps, benches, cars and signs.

use super::albedo;
use crate::WorldBuilder;

impl WorldBuilder {
    /// A tree on level ground: trunk, branches, and a crown of overlapping spheres.
    pub(super) fn tree(&mut self, at: [f64; 2], scale: f64) {
        let [x, y] = at;
        let trunk = self.random.range(2.4, 3.4) * scale;
        let radius = self.random.range(0.14, 0.3) * scale;
        let spread = self.random.range(1.2, 1.9) * scale;
        self.column([x, y, -0.2], trunk + 0.8, radius, albedo::BARK);
        let count = 5 + self.random.index(4);
        for k in 0..count {
            let angle = std::f64::consts::TAU * (k as f64 + self.random.uniform()) / count as f64;
            let reach = spread * self.random.range(0.3, 0.9);
            let ball = [x + reach * angle.cos(), y + reach * angle.sin(), trunk + self.random.range(0.3, 2.0) * scale];
            let fork = trunk * self.random.range(0.6, 0.9);
            self.capsule([x, y, fork], ball, 0.06 * scale, albedo::BARK);
            let size = self.random.range(0.6, 1.1) * scale;
            self.sphere(ball, size, albedo::LEAVES);
        }
        self.sphere([x, y, trunk + 1.6 * scale], 1.1 * scale, albedo::LEAVES);
    }

    /// An iron railing 1.2 m high with bars of 5 cm every 15 cm, posts every 3 m.
    pub(super) fn railing(&mut self, from: [f64; 2], to: [f64; 2]) {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        let at = |s: f64, z: f64| [from[0] + (to[0] - from[0]) * s / length, from[1] + (to[1] - from[1]) * s / length, z];
        let bars = (length / 0.15) as usize;
        for k in 0..=bars {
            let post = k % 20 == 0;
            let (radius, top) = if post { (0.05, 1.35) } else { (0.025, 1.2) };
            let s = k as f64 * 0.15;
            self.capsule(at(s, -0.1), at(s, top), radius, albedo::IRON);
        }
        for z in [0.15, 1.1] {
            self.capsule(at(0.0, z), at(length, z), 0.025, albedo::IRON);
        }
    }

    /// A bollard.
    pub(super) fn bollard(&mut self, at: [f64; 2]) {
        self.column([at[0], at[1], -0.1], 1.0, 0.1, albedo::IRON);
        self.sphere([at[0], at[1], 0.92], 0.12, albedo::PAINT);
    }

    /// A street lamp, 5 m, with an arm of 1.2 m towards `arm` radians.
    pub(super) fn lamp(&mut self, at: [f64; 2], arm: f64) {
        let [x, y] = at;
        self.column([x, y, -0.1], 5.1, 0.06, albedo::IRON);
        self.column([x, y, -0.1], 1.0, 0.1, albedo::IRON);
        let end = [x + 1.2 * arm.cos(), y + 1.2 * arm.sin(), 5.2];
        self.capsule([x, y, 5.0], end, 0.04, albedo::IRON);
        self.turned([end[0], end[1], 5.15], [0.6, 0.2, 0.12], arm, albedo::PAINT);
    }

    /// A bench of 1.6 m.
    pub(super) fn bench(&mut self, at: [f64; 2], yaw: f64) {
        let [x, y] = at;
        let (sin, cos) = yaw.sin_cos();
        let local = |u: f64, v: f64, z: f64| [x + cos * u - sin * v, y + sin * u + cos * v, z];
        self.turned(local(0.0, 0.0, 0.45), [1.6, 0.45, 0.06], yaw, albedo::WOOD);
        self.turned(local(0.0, 0.2, 0.75), [1.6, 0.05, 0.3], yaw, albedo::WOOD);
        for side in [-0.7, 0.7] {
            self.turned(local(side, 0.0, 0.22), [0.08, 0.4, 0.46], yaw, albedo::IRON);
            self.turned(local(side, 0.2, 0.6), [0.06, 0.05, 0.6], yaw, albedo::IRON);
        }
    }

    /// A table of 1.4 x 0.8 m, 75 cm high, on level ground.
    pub(super) fn table(&mut self, [x, y]: [f64; 2], yaw: f64) {
        let (sin, cos) = yaw.sin_cos();
        self.turned([x, y, 0.73], [1.4, 0.8, 0.04], yaw, albedo::WOOD);
        for (u, v) in [(-0.65, -0.35), (-0.65, 0.35), (0.65, -0.35), (0.65, 0.35)] {
            self.column([x + cos * u - sin * v, y + sin * u + cos * v, -0.05], 0.78, 0.03, albedo::WOOD);
        }
    }

    /// A car of about 4.2 x 1.75 m with heading `yaw`.
    pub(crate) fn car(&mut self, at: [f64; 2], yaw: f64) {
        let [x, y] = at;
        let (sin, cos) = yaw.sin_cos();
        let local = |u: f64, v: f64, z: f64| [x + cos * u - sin * v, y + sin * u + cos * v, z];
        let length = self.random.range(3.7, 4.6);
        let roof = self.random.range(1.4, 1.75);
        let paint = self.random.range(0.1, 0.8) as f32;
        self.turned(local(0.0, 0.0, 0.6), [length, 1.74, 0.66], yaw, paint);
        self.turned(local(-0.15, 0.0, (0.9 + roof) / 2.0), [0.52 * length, 1.5, roof - 0.9], yaw, albedo::GLASS);
        self.turned(local(-0.15, 0.0, roof), [0.42 * length, 1.4, 0.08], yaw, paint);
        // A rounded bonnet and boot.
        for end in [-0.48, 0.48] {
            self.capsule(local(end * length, -0.6, 0.6), local(end * length, 0.6, 0.6), 0.24, paint);
        }
        for (u, v) in [(-0.32, -1.0), (-0.32, 1.0), (0.32, -1.0), (0.32, 1.0)] {
            self.cylinder(local(u * length, v * 0.66, 0.31), local(u * length, v * 0.89, 0.31), 0.31, albedo::IRON);
        }
        for side in [-1.0, 1.0] {
            self.sphere(local(0.14 * length, side * 0.95, 0.98), 0.1, paint);
        }
    }

    /// A sign of 0.6 m on a post, facing along `yaw`.
    pub(super) fn sign(&mut self, at: [f64; 2], yaw: f64) {
        self.column([at[0], at[1], -0.1], 2.7, 0.03, albedo::IRON);
        self.turned([at[0] + 0.05 * yaw.cos(), at[1] + 0.05 * yaw.sin(), 2.3], [0.03, 0.6, 0.6], yaw, albedo::SIGN);
    }
}
