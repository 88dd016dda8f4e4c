//! Layers of a mesh: whether a place on it has one surface, or several on top of each other.

use crate::mesh::MeshView;
use crate::triangle_bvh::TriangleBvh;
use crate::vec3::{cross, dot, sub};
use rayon::prelude::*;
use serde::Serialize;

/// The usual number of places.
pub const LAYER_PLACES: usize = 50_000;
/// The usual reach, metres.
pub const LAYER_REACH: f32 = 0.08;
/// Crossings of one normal that are nearer together than this, metres, are one layer: those with the two triangles of an edge.
const LAYER_MERGE_DISTANCE: f32 = 1e-3;

/// How many surfaces lie on top of each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Layers {
    /// Number of places on the mesh, evenly distributed over its area.
    pub places: usize,
    /// Distance along the normal, to both sides, within which surfaces count, metres.
    pub reach_m: f32,
    /// Share of the places with exactly one surface.
    pub single: f64,
    /// Mean number of surfaces per place.
    pub mean: f64,
    /// Area of the mesh, square metres.
    pub area_m2: f64,
}

/// Counts the surfaces within `reach` metres along the normal at about `places` places, evenly distributed over the area. None for a mesh without
/// area. The result does not depend on the number of threads.
pub fn layers(mesh: &MeshView<'_>, places: usize, reach: f32) -> Option<Layers> {
    let triangles = mesh.triangles().len();
    let normal = |i: usize| {
        let [a, b, c] = mesh.corners(i);
        cross(sub(b, a), sub(c, a))
    };
    let area = |i: usize| if mesh.is_finite(i) { 0.5 * f64::from(dot(normal(i), normal(i))).sqrt() } else { 0.0 };
    let total: f64 = (0..triangles).map(area).sum();
    if total <= 0.0 || places == 0 {
        return None;
    }
    let (mut chosen, mut sum, step) = (Vec::with_capacity(places), 0.0, total / places as f64);
    for i in 0..triangles {
        sum += area(i);
        // A triangle is a place once, however large it is.
        if sum >= (chosen.len() as f64 + 0.5) * step {
            chosen.push(i);
            sum = sum.min((chosen.len() as f64 + 0.5) * step);
        }
    }
    let bvh = TriangleBvh::new(mesh);
    let count = |&i: &usize| {
        let ([a, b, c], n) = (mesh.corners(i), normal(i));
        let (p, length) = (std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0), dot(n, n).sqrt());
        crossings(&bvh, p, n.map(|v| v / length), reach)
    };
    let counts: Vec<usize> = chosen.par_iter().map(count).collect();
    let share = |n: usize| n as f64 / counts.len().max(1) as f64;
    let single = share(counts.iter().filter(|n| **n == 1).count());
    Some(Layers { places: counts.len(), reach_m: reach, single, mean: share(counts.iter().sum()), area_m2: total })
}

/// Number of surfaces that cross the line through `p` along `n` within `reach`; that at `p` itself is one of them.
fn crossings(bvh: &TriangleBvh, p: [f32; 3], n: [f32; 3], reach: f32) -> usize {
    let mut at = vec![0.0f32];
    bvh.visit(p, reach * reach, |slot, _, distance2, _| {
        if distance2 <= reach * reach {
            at.extend(crossing(bvh.corners(slot), p, n).filter(|t| t.abs() <= reach));
        }
    });
    at.sort_by(f32::total_cmp);
    1 + at.windows(2).filter(|pair| pair[1] - pair[0] > LAYER_MERGE_DISTANCE).count()
}

/// Where the line through `p` along `n` crosses a triangle (Möller and Trumbore 1997), borders included.
fn crossing([a, b, c]: [[f32; 3]; 3], p: [f32; 3], n: [f32; 3]) -> Option<f32> {
    let (u, v, from) = (sub(b, a), sub(c, a), sub(p, a));
    let across = cross(n, v);
    let det = dot(u, across);
    if det.abs() < 1e-12 {
        return None;
    }
    let (s, q) = (dot(from, across) / det, cross(from, u));
    let t = dot(n, q) / det;
    (s >= 0.0 && t >= 0.0 && s + t <= 1.0).then(|| dot(v, q) / det)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Floors of 10 x 10 m in squares of 0.5 m at the given heights.
    fn floors(heights: &[f32]) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for z in heights {
            for i in 0..400u32 {
                let (x, y, first) = ((i % 20) as f32 * 0.5, (i / 20) as f32 * 0.5, vertices.len() as u32);
                vertices.extend([[x, y, *z], [x + 0.5, y, *z], [x, y + 0.5, *z], [x + 0.5, y + 0.5, *z]]);
                triangles.extend([[first, first + 1, first + 2], [first + 1, first + 3, first + 2]]);
            }
        }
        (vertices, triangles)
    }

    #[test]
    fn floors_within_reach_are_layers_of_each_other() {
        for (heights, mean, single) in
            [(&[0.0][..], 1.0, 1.0), (&[0.0, 0.05], 2.0, 0.0), (&[0.0, 0.2], 1.0, 1.0), (&[0.0, 0.05, 0.5], 5.0 / 3.0, 1.0 / 3.0)]
        {
            let (vertices, triangles) = floors(heights);
            let mesh = MeshView::new(&vertices, &triangles).unwrap();
            let found = layers(&mesh, 300, 0.08).unwrap();
            assert!((found.mean - mean).abs() < 0.02 && (found.single - single).abs() < 0.02, "{heights:?}: {found:?}");
            assert!((found.area_m2 - 100.0 * heights.len() as f64).abs() < 1e-2 && found.places > 250, "{found:?}");
        }
        assert!(layers(&MeshView::new(&[], &[]).unwrap(), 300, 0.08).is_none());
    }
}
