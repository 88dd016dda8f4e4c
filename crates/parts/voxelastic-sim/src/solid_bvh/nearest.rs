//! Queries for the nearest solid.

use super::node::{MAX_DEPTH, Node, SolidBvh};
use crate::solid::{Solid, Vec3};

/// Lower bound of the distance from `p` to the solids of a node, metres; zero inside of its box.
#[inline]
fn distance_to_box(node: &Node, p: &Vec3) -> f64 {
    let side = |k: usize| (f64::from(node.min[k]) - p[k]).max(p[k] - f64::from(node.max[k])).max(0.0);
    Vec3::new(side(0), side(1), side(2)).norm()
}

impl SolidBvh {
    /// The smallest signed distance of a solid to `p` and its index, if below `limit`. Inside of several solids it is the one whose surface is
    /// farthest.
    pub(crate) fn nearest(&self, solids: &[Solid], p: &Vec3, limit: f64) -> Option<(f64, u32)> {
        let mut best = (limit, None);
        let mut stack = [(0.0, 0u32); MAX_DEPTH + 2];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (lower, index) = stack[depth];
            // A box that contains the point is always visited: solids that contain it are compared by depth.
            if lower > 0.0 && lower >= best.0 {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for k in node.first..node.first + node.count {
                    let d = solids[k as usize].distance(p);
                    if d < best.0 {
                        best = (d, Some(k));
                    }
                }
                continue;
            }
            let (a, b) = (
                (distance_to_box(&self.nodes[node.first as usize], p), node.first),
                (distance_to_box(&self.nodes[node.first as usize + 1], p), node.first + 1),
            );
            let (near, far) = if a.0 <= b.0 { (a, b) } else { (b, a) };
            stack[depth] = far;
            stack[depth + 1] = near;
            depth += 2;
        }
        best.1.map(|index| (best.0, index))
    }
}
