//! Ray casting in packets: neighbouring rays share one traversal, and each test is a loop over lanes that vectorises.

use super::node::{MAX_DEPTH, Node, SolidBvh};
use crate::solid::{Solid, Vec3, on_shape};

/// Rays in a packet.
pub(crate) const LANES: usize = 16;

/// A packet of rays and their nearest hits so far. Unused lanes repeat the last ray.
#[derive(Clone, Debug)]
pub(crate) struct Packet {
    origin: [[f64; LANES]; 3],
    direction: [[f64; LANES]; 3],
    /// For boxes: origin, 1 / direction and nearest hit in single precision.
    near_origin: [[f32; LANES]; 3],
    inverse: [[f32; LANES]; 3],
    limit: [f32; LANES],
    /// Distance of the nearest hit, or the largest range.
    pub(crate) range: [f64; LANES],
    /// Index of the solid hit, `u32::MAX` for none.
    pub(crate) solid: [u32; LANES],
}

/// Factor on distances to boxes, larger than the rounding of single precision.
const ROUNDING_MARGIN: f32 = 1.0 + 4.0 * f32::EPSILON;

impl Packet {
    /// A packet of 1 to [`LANES`] rays (origin, unit direction) of at most `range` metres.
    pub(crate) fn new(rays: &[(Vec3, Vec3)], range: f64) -> Self {
        let mut packet = Self {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            near_origin: [[0.0; LANES]; 3],
            inverse: [[0.0; LANES]; 3],
            limit: [range as f32 * ROUNDING_MARGIN; LANES],
            range: [range; LANES],
            solid: [u32::MAX; LANES],
        };
        for lane in 0..LANES {
            let Some((origin, direction)) = rays.get(lane).or(rays.last()) else { continue };
            for k in 0..3 {
                packet.origin[k][lane] = origin[k];
                packet.direction[k][lane] = direction[k];
                packet.near_origin[k][lane] = origin[k] as f32;
                packet.inverse[k][lane] = crate::solid::reciprocal(direction[k]) as f32;
            }
        }
        packet
    }

    /// Intersects all lanes with `solid`. A ray that starts inside has a hit at range 0.
    #[inline]
    pub(crate) fn hit(&mut self, index: u32, solid: &Solid) {
        on_shape!(solid, shape => {
            for lane in 0..LANES {
                let origin = Vec3::new(self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]);
                let direction = Vec3::new(self.direction[0][lane], self.direction[1][lane], self.direction[2][lane]);
                let (enter, exit) = shape.interval(&origin, &direction);
                let range = if enter > 0.0 { enter } else { 0.0 };
                let nearer = (exit > 0.0) & (range < self.range[lane]);
                self.range[lane] = if nearer { range } else { self.range[lane] };
                self.solid[lane] = if nearer { index } else { self.solid[lane] };
            }
        });
        for lane in 0..LANES {
            self.limit[lane] = self.range[lane] as f32 * ROUNDING_MARGIN;
        }
    }

    /// Whether any lane intersects the box before its nearest hit.
    #[inline]
    fn intersects(&self, node: &Node) -> bool {
        let smaller = |a: f32, b: f32| if a < b { a } else { b };
        let larger = |a: f32, b: f32| if a > b { a } else { b };
        let mut any = 0u32;
        for lane in 0..LANES {
            let (mut enter, mut exit) = (0.0f32, self.limit[lane]);
            for k in 0..3 {
                let a = (node.min[k] - self.near_origin[k][lane]) * self.inverse[k][lane];
                let b = (node.max[k] - self.near_origin[k][lane]) * self.inverse[k][lane];
                enter = larger(enter, smaller(a, b));
                exit = smaller(exit, larger(a, b));
            }
            any |= u32::from(enter <= exit * ROUNDING_MARGIN);
        }
        any != 0
    }
}

impl SolidBvh {
    /// Finds the nearest hit of every ray of the packet.
    pub(crate) fn cast(&self, solids: &[Solid], packet: &mut Packet) {
        let mut stack = [0u32; MAX_DEPTH + 2];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let node = &self.nodes[stack[depth] as usize];
            if !packet.intersects(node) {
                continue;
            }
            if node.count > 0 {
                for index in node.first..node.first + node.count {
                    packet.hit(index, &solids[index as usize]);
                }
            } else {
                // The child that the packet reaches first is visited first.
                let backwards = packet.direction[node.axis as usize][0] < 0.0;
                let (near, far) = if backwards { (node.first + 1, node.first) } else { (node.first, node.first + 1) };
                stack[depth] = far;
                stack[depth + 1] = near;
                depth += 2;
            }
        }
    }
}
