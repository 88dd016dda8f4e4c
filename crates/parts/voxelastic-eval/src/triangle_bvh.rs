//! A bounding volume hierarchy over the triangles of a mesh, for millions of closest-point queries in single precision.
//!
//! It shares no code with the hierarchy of `voxelastic-sim`, which holds a few thousand analytic solids and casts packets of rays in double precision:
//! node layout, split rule and queries all differ. Libraries were considered: parry3d takes 8.4 µs per query on a scanned mesh and adds 41
//! dependencies; obvhs and bvh have fast rays but no closest-point query.

use crate::mesh::MeshView;
use crate::vec3;
use rayon::prelude::*;

/// Triangles per leaf.
const LEAF: usize = 4;
/// Subtrees of at most this many triangles are built by one thread.
const SERIAL_BUILD: usize = 1 << 13;

/// A box, and either its two children or its triangles.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    min: [f32; 3],
    /// Inner node: offset in nodes of the right child (the left child is the next node). Leaf: first triangle.
    link: u32,
    max: [f32; 3],
    /// Number of triangles of a leaf, 0 for an inner node.
    count: u32,
}

impl Node {
    /// Squared distance from a point to the box.
    #[inline(always)]
    fn distance2(&self, p: [f32; 3]) -> f32 {
        let d: [f32; 3] = std::array::from_fn(|k| (self.min[k] - p[k]).max(p[k] - self.max[k]).max(0.0));
        vec3::dot(d, d)
    }
}

/// The hierarchy, with a copy of the triangles in leaf order.
pub(crate) struct TriangleBvh {
    nodes: Vec<Node>,
    corners: Vec<[[f32; 3]; 3]>,
    /// Position in the mesh of each triangle of `corners`.
    original: Vec<u32>,
}

/// A triangle near a query point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    pub distance2: f32,
    pub point: [f32; 3],
    /// Position in leaf order.
    pub slot: u32,
}

impl TriangleBvh {
    /// Builds the hierarchy over the finite triangles of a mesh.
    pub fn new(mesh: &MeshView<'_>) -> Self {
        let mut original: Vec<u32> = (0..mesh.triangles().len() as u32).into_par_iter().filter(|&i| mesh.is_finite(i as usize)).collect();
        let mut items: Vec<([f32; 3], u32)> = original
            .par_iter()
            .map(|&i| {
                let c = mesh.corners(i as usize);
                (std::array::from_fn(|k| (c[0][k] + c[1][k] + c[2][k]) / 3.0), i)
            })
            .collect();
        let mut nodes = vec![Node::default(); if items.is_empty() { 0 } else { node_count(items.len()) }];
        if !items.is_empty() {
            build(mesh, &mut nodes, &mut items, 0);
        }
        original.iter_mut().zip(&items).for_each(|(o, i)| *o = i.1);
        let corners = original.par_iter().map(|&i| mesh.corners(i as usize)).collect();
        Self { nodes, corners, original }
    }

    /// Whether there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Corners of the triangle in a slot.
    pub fn corners(&self, slot: u32) -> [[f32; 3]; 3] {
        self.corners[slot as usize]
    }

    /// Position in the mesh of the triangle in a slot.
    pub fn original(&self, slot: u32) -> u32 {
        self.original[slot as usize]
    }

    /// The closest point of the mesh within the square root of `limit2`. `guess` is a slot that is probably near, for instance that of a neighbouring
    /// query.
    pub fn closest(&self, p: [f32; 3], limit2: f32, guess: Option<u32>) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        let mut bound = limit2;
        if let Some(slot) = guess {
            let point = closest_point(self.corners(slot), p);
            let distance2 = length2(point, p);
            if distance2 <= bound {
                (best, bound) = (Some(Hit { distance2, point, slot }), distance2);
            }
        }
        self.visit(p, bound, |slot, point, distance2, bound| {
            if distance2 < *bound || (best.is_none() && distance2 <= *bound) {
                *bound = distance2;
                best = Some(Hit { distance2, point, slot });
            }
        });
        best
    }

    /// Calls `found(slot, closest point, squared distance, bound)` for the triangles of all leaves that may be within the square root of the bound, near
    /// leaves first. The callee may lower the bound.
    pub fn visit(&self, p: [f32; 3], mut bound: f32, mut found: impl FnMut(u32, [f32; 3], f32, &mut f32)) {
        let mut stack = [(0u32, 0.0f32); 64];
        let mut depth = 0usize;
        let Some(root) = self.nodes.first() else { return };
        let mut next = Some((0u32, root.distance2(p)));
        loop {
            let (index, distance) = match next.take() {
                Some(n) => n,
                None if depth == 0 => return,
                None => {
                    depth -= 1;
                    stack[depth]
                }
            };
            if distance > bound {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for slot in node.link..node.link + node.count {
                    let point = closest_point(self.corners[slot as usize], p);
                    found(slot, point, length2(point, p), &mut bound);
                }
                continue;
            }
            let (left, right) = (index + 1, index + node.link);
            let (dl, dr) = (self.nodes[left as usize].distance2(p), self.nodes[right as usize].distance2(p));
            let (near, far) = if dl <= dr { ((left, dl), (right, dr)) } else { ((right, dr), (left, dl)) };
            // Median splits make the tree at most 32 deep: the stack cannot overflow.
            if far.1 <= bound {
                stack[depth] = far;
                depth += 1;
            }
            next = Some(near);
        }
    }
}

/// Nodes of a tree over `n` triangles.
fn node_count(n: usize) -> usize {
    if n <= LEAF { 1 } else { 1 + node_count(n / 2) + node_count(n - n / 2) }
}

fn build(mesh: &MeshView<'_>, nodes: &mut [Node], items: &mut [([f32; 3], u32)], first: usize) {
    let n = items.len();
    if n <= LEAF {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for c in items.iter().flat_map(|i| mesh.corners(i.1 as usize)) {
            (0..3).for_each(|k| (min[k], max[k]) = (min[k].min(c[k]), max[k].max(c[k])));
        }
        nodes[0] = Node { min, max, link: first as u32, count: n as u32 };
        return;
    }
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (c, _) in items.iter() {
        (0..3).for_each(|k| (lo[k], hi[k]) = (lo[k].min(c[k]), hi[k].max(c[k])));
    }
    let axis = (1..3).fold(0, |a, k| if hi[k] - lo[k] > hi[a] - lo[a] { k } else { a });
    let half = n / 2;
    items.select_nth_unstable_by(half, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
    let (left, right) = items.split_at_mut(half);
    let (head, rest) = nodes.split_at_mut(1);
    let (left_nodes, right_nodes) = rest.split_at_mut(node_count(half));
    if n > SERIAL_BUILD {
        rayon::join(|| build(mesh, left_nodes, left, first), || build(mesh, right_nodes, right, first + half));
    } else {
        build(mesh, left_nodes, left, first);
        build(mesh, right_nodes, right, first + half);
    }
    let (a, b) = (left_nodes[0], right_nodes[0]);
    head[0] = Node {
        min: std::array::from_fn(|k| a.min[k].min(b.min[k])),
        max: std::array::from_fn(|k| a.max[k].max(b.max[k])),
        link: 1 + left_nodes.len() as u32,
        count: 0,
    };
}

#[inline(always)]
fn length2(a: [f32; 3], b: [f32; 3]) -> f32 {
    let d = vec3::sub(a, b);
    vec3::dot(d, d)
}

/// The point of a triangle closest to `p`, by the Voronoi regions of its corners, edges and face (Ericson, Real-Time Collision Detection, 5.1.5).
#[inline]
pub(crate) fn closest_point([a, b, c]: [[f32; 3]; 3], p: [f32; 3]) -> [f32; 3] {
    use vec3::{dot, sub};
    let along = |from: [f32; 3], d: [f32; 3], t: f32| [from[0] + d[0] * t, from[1] + d[1] * t, from[2] + d[2] * t];
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return along(a, ab, ratio(d1, d1 - d3));
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return along(a, ac, ratio(d2, d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return along(b, sub(c, b), ratio(d4 - d3, (d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    let (v, w) = (ratio(vb, sum), ratio(vc, sum));
    along(along(a, ab, v), ac, w)
}

/// Quotient of non-negative numbers, at most 1; 0 for a degenerate triangle.
#[inline(always)]
fn ratio(a: f32, b: f32) -> f32 {
    if b > 0.0 { (a / b).min(1.0) } else { 0.0 }
}
