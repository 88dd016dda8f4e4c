//! The triangles of a piece of surface, for the nearest point of them: boxes of eight triangles, boxes of eight of these, and so on.

/// Children of a node.
const WIDTH: usize = 8;

/// The boxes around the children of a node, axis by axis; missing ones are infinitely far.
#[derive(Clone, Debug)]
struct Node {
    low: [[f32; WIDTH]; 3],
    high: [[f32; WIDTH]; 3],
}

/// Triangles, in an order in which neighbours are near each other, and the boxes around them.
#[derive(Clone, Debug, Default)]
pub(crate) struct TriangleIndex {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Nodes over triangles, nodes over these, up to one.
    levels: Vec<Vec<Node>>,
}

/// The nearest point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    /// Squared distance.
    pub squared: f32,
    pub point: [f32; 3],
}

impl Nearest {
    /// Beyond this squared distance nothing is looked for.
    pub fn within(squared: f32) -> Self {
        Self { squared, point: [f32::INFINITY; 3] }
    }

    /// Whether a point was found.
    pub fn is_found(&self) -> bool {
        self.point[0].is_finite()
    }

    /// Of two points at the same distance the one with the smaller coordinates, so that the answer does not depend on the order of triangles.
    fn improve(&mut self, squared: f32, point: [f32; 3]) {
        if squared < self.squared || squared == self.squared && point < self.point {
            *self = Self { squared, point };
        }
    }
}

impl Node {
    const EMPTY: Self = Self { low: [[f32::INFINITY; WIDTH]; 3], high: [[f32::NEG_INFINITY; WIDTH]; 3] };

    fn set(&mut self, child: usize, (low, high): ([f32; 3], [f32; 3])) {
        (0..3).for_each(|k| (self.low[k][child], self.high[k][child]) = (low[k], high[k]));
    }

    /// The box around all children.
    fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        (self.low.map(|v| v.into_iter().fold(f32::INFINITY, f32::min)), self.high.map(|v| v.into_iter().fold(f32::NEG_INFINITY, f32::max)))
    }

    /// Squared distances to the boxes.
    #[inline]
    fn squared_distances(&self, p: [f32; 3]) -> [f32; WIDTH] {
        let mut squared = [0.0; WIDTH];
        for ((low, high), c) in self.low.iter().zip(&self.high).zip(p) {
            for ((squared, low), high) in squared.iter_mut().zip(low).zip(high) {
                let outside = (low - c).max(c - high).max(0.0);
                *squared += outside * outside;
            }
        }
        squared
    }
}

impl TriangleIndex {
    /// An index of the triangles of a mesh.
    pub fn new(mut positions: Vec<[f32; 3]>, mut triangles: Vec<[u32; 3]>) -> Self {
        let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
        let centre = |t: &[u32; 3]| -> [f32; 3] {
            let [a, b, c] = corners(t);
            std::array::from_fn(|k| a[k] + b[k] + c[k])
        };
        let mut bounds = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for c in triangles.iter().map(centre) {
            bounds = (std::array::from_fn(|k| bounds.0[k].min(c[k])), std::array::from_fn(|k| bounds.1[k].max(c[k])));
        }
        let scale = 1023.0 / (0..3).map(|k| bounds.1[k] - bounds.0[k]).fold(1e-6, f32::max);
        triangles.sort_by_cached_key(|t| {
            let c = centre(t);
            (0..3).fold(0u32, |key, k| key | spread(((c[k] - bounds.0[k]) * scale) as u32) << k)
        });
        let mut boxes: Vec<_> = triangles.iter().map(|t| bounds_of(&corners(t))).collect();
        positions.shrink_to_fit();
        let mut levels = Vec::new();
        while boxes.len() > 1 || levels.is_empty() && !boxes.is_empty() {
            let node = |boxes: &[([f32; 3], [f32; 3])]| {
                let mut node = Node::EMPTY;
                boxes.iter().enumerate().for_each(|(i, bounds)| node.set(i, *bounds));
                node
            };
            let nodes: Vec<Node> = boxes.chunks(WIDTH).map(node).collect();
            boxes = nodes.iter().map(Node::bounds).collect();
            levels.push(nodes);
        }
        Self { positions, triangles, levels }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        let mesh = self.positions.capacity() * size_of::<[f32; 3]>() + self.triangles.capacity() * size_of::<[u32; 3]>();
        mesh + self.levels.iter().map(Vec::len).sum::<usize>() * size_of::<Node>()
    }

    /// Replaces `nearest` by the point of the triangles that is nearest to `p`, if that is nearer.
    pub fn find(&self, p: [f32; 3], nearest: &mut Nearest) {
        if let Some(top) = self.levels.len().checked_sub(1) {
            self.visit(top, 0, p, nearest);
        }
    }

    fn visit(&self, level: usize, node: usize, p: [f32; 3], nearest: &mut Nearest) {
        let mut squared = self.levels[level][node].squared_distances(p);
        loop {
            // The nearest child first; those that were visited are infinitely far.
            let (child, &least) = squared.iter().enumerate().fold((0, &squared[0]), |best, next| if next.1 < best.1 { next } else { best });
            if least > nearest.squared || least == f32::INFINITY {
                return;
            }
            squared[child] = f32::INFINITY;
            let child = node * WIDTH + child;
            if level > 0 {
                self.visit(level - 1, child, p, nearest);
            } else {
                let point = closest(&self.triangles[child].map(|v| self.positions[v as usize]), p);
                nearest.improve((0..3).map(|k| (p[k] - point[k]).powi(2)).sum(), point);
            }
        }
    }
}

/// Two zero bits between the lowest ten bits.
fn spread(v: u32) -> u32 {
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}

fn bounds_of(t: &[[f32; 3]; 3]) -> ([f32; 3], [f32; 3]) {
    (std::array::from_fn(|k| t[0][k].min(t[1][k]).min(t[2][k])), std::array::from_fn(|k| t[0][k].max(t[1][k]).max(t[2][k])))
}

/// The point of a triangle that is nearest to `p`: in its plane if that is inside, else on the nearest edge.
fn closest(t: &[[f32; 3]; 3], p: [f32; 3]) -> [f32; 3] {
    let minus = |a: [f32; 3], b: [f32; 3]| -> [f32; 3] { std::array::from_fn(|k| a[k] - b[k]) };
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (u, v, w) = (minus(t[1], t[0]), minus(t[2], t[0]), minus(p, t[0]));
    let (uu, uv, vv, wu, wv) = (dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v));
    let determinant = uu * vv - uv * uv;
    let (a, b) = (vv * wu - uv * wv, uu * wv - uv * wu);
    // Thin triangles are their edges.
    if determinant > 1e-6 * uu * vv && a >= 0.0 && b >= 0.0 && a + b <= determinant {
        let (a, b) = (a / determinant, b / determinant);
        return std::array::from_fn(|k| t[0][k] + a * u[k] + b * v[k]);
    }
    let on_edge = |from: [f32; 3], to: [f32; 3]| -> [f32; 3] {
        let along = minus(to, from);
        let length = dot(along, along);
        let share = if length > 0.0 { (dot(minus(p, from), along) / length).clamp(0.0, 1.0) } else { 0.0 };
        std::array::from_fn(|k| from[k] + share * along[k])
    };
    let squared = |q: &[f32; 3]| dot(minus(p, *q), minus(p, *q));
    let edges = [on_edge(t[0], t[1]), on_edge(t[1], t[2]), on_edge(t[2], t[0])];
    edges[1..].iter().fold(edges[0], |best, q| if squared(q) < squared(&best) { *q } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn distance(p: [f64; 3], q: [f64; 3]) -> f64 {
        (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>().sqrt()
    }

    /// Distance to a triangle by looking at a lattice of its points, and the width of the lattice.
    fn slow(t: &[[f32; 3]; 3], p: [f32; 3]) -> (f64, f64) {
        const STEPS: usize = 60;
        let [a, b, c] = t.map(|v| v.map(f64::from));
        let at = |i: usize, j: usize| -> [f64; 3] {
            let (u, v) = (i as f64 / STEPS as f64, j as f64 / STEPS as f64);
            std::array::from_fn(|k| a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k]))
        };
        let all = (0..=STEPS).flat_map(|i| (0..=STEPS - i).map(move |j| (i, j)));
        let nearest = all.map(|(i, j)| distance(p.map(f64::from), at(i, j))).fold(f64::INFINITY, f64::min);
        (nearest, (distance(a, b) + distance(a, c)) / STEPS as f64)
    }

    proptest! {
        #[test]
        fn the_nearest_point_is_that_of_all_triangles(
            corners in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-4i8..4)), 1..40),
            p in prop::array::uniform3(-6.0f32..6.0),
            within in 0.1f32..12.0,
        ) {
            // On a lattice, so that some triangles are lines or points, and some points are equally far.
            let positions: Vec<[f32; 3]> = corners.iter().flatten().map(|c| c.map(f32::from)).collect();
            let triangles: Vec<[u32; 3]> = (0..corners.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
            let reversed: Vec<[u32; 3]> = triangles.iter().rev().copied().collect();
            let find = |triangles: &[[u32; 3]]| {
                let mut nearest = Nearest::within(within * within);
                TriangleIndex::new(positions.clone(), triangles.to_vec()).find(p, &mut nearest);
                nearest
            };
            let nearest = find(&triangles);
            prop_assert_eq!(nearest, find(&reversed), "whatever their order");
            let all = corners.iter().map(|t| slow(&t.map(|c| c.map(f32::from)), p));
            let (expected, width) = all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap();
            if nearest.is_found() {
                let found = f64::from(nearest.squared).sqrt();
                prop_assert!(found <= expected + 1e-4 && found >= expected - width, "{} and {}", found, expected);
                prop_assert!((distance(p.map(f64::from), nearest.point.map(f64::from)) - found).abs() < 1e-4);
            } else {
                prop_assert!(expected > f64::from(within) - 1e-4, "{} within {}", expected, within);
            }
        }
    }

    #[test]
    fn no_triangles_are_far() {
        let mut nearest = Nearest::within(4.0);
        TriangleIndex::new(Vec::new(), Vec::new()).find([0.0; 3], &mut nearest);
        assert!(!nearest.is_found());
    }
}
