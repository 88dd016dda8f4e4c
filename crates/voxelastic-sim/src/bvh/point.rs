//! What is around a point.

use super::{Bvh, MAX_DEPTH, Node};
use crate::solid::{Solid, Vec3};

/// Lower bound of the distance from `p` to what a node holds, metres; zero inside of its box.
#[inline]
fn gap(node: &Node, p: &Vec3) -> f64 {
    let side = |k: usize| (f64::from(node.min[k]) - p[k]).max(p[k] - f64::from(node.max[k])).max(0.0);
    Vec3::new(side(0), side(1), side(2)).norm()
}

impl Bvh {
    /// The solid with the smallest signed distance to `p`, if below `limit`: exact outside of all solids. Inside it is the
    /// solid whose own surface is farthest, among those that hold `p`.
    pub(crate) fn nearest(&self, solids: &[Solid], p: &Vec3, limit: f64) -> Option<(f64, u32)> {
        let mut best = (limit, None);
        let mut stack = [(0.0, 0u32); MAX_DEPTH + 2];
        let mut open = usize::from(!self.nodes.is_empty());
        while open > 0 {
            open -= 1;
            let (lower, index) = stack[open];
            // Solids that hold the point compete by depth, so a box that holds it is always entered.
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
            let (a, b) = ((gap(&self.nodes[node.first as usize], p), node.first), (gap(&self.nodes[node.first as usize + 1], p), node.first + 1));
            let (near, far) = if a.0 <= b.0 { (a, b) } else { (b, a) };
            stack[open] = far;
            stack[open + 1] = near;
            open += 2;
        }
        best.1.map(|index| (best.0, index))
    }
}
