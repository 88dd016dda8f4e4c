//! Exact distances from points to a triangle mesh, for millions of points.

use crate::mesh::MeshView;
use crate::morton_order::map_in_morton_order;
use crate::triangle_bvh::{Hit, TriangleBvh};
use crate::{EvalError, error::Result, vec3};

/// An index of a mesh for closest-point queries. Building it takes about half a second for a million triangles.
pub struct MeshIndex {
    bvh: TriangleBvh,
}

/// The point of a mesh closest to a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Distance, metres.
    pub distance: f32,
    /// The point on the mesh, metres.
    pub point: [f32; 3],
    /// Position of its triangle in the mesh.
    pub triangle: u32,
}

impl MeshIndex {
    /// Indexes the finite triangles of a mesh.
    ///
    /// # Errors
    /// [`EvalError::Empty`] when there are none.
    pub fn new(mesh: &MeshView<'_>) -> Result<Self> {
        let bvh = TriangleBvh::new(mesh);
        if bvh.is_empty() {
            return Err(EvalError::Empty { what: "the mesh", of: "triangles" });
        }
        Ok(Self { bvh })
    }

    /// The closest point within `cut_off` metres (infinity for no limit); none when nothing is within it or `p` is not finite.
    pub fn closest(&self, p: [f32; 3], cut_off: f32) -> Option<Closest> {
        self.hit(p, cut_off, None).map(|h| Closest { distance: h.distance2.sqrt(), point: h.point, triangle: self.bvh.original(h.slot) })
    }

    /// Distance of each point to the mesh, metres: infinity beyond `cut_off`, NaN for a point that is not finite.
    pub fn distances(&self, points: &[[f32; 3]], cut_off: f32) -> Vec<f32> {
        self.map_hits(points, cut_off, |_, hit| hit.distance2.sqrt())
    }

    /// Like [`MeshIndex::distances`], but negative behind the surface, by the winding of the closest triangle.
    ///
    /// At edges and corners the triangle most perpendicular to the direction of the point decides, which gives the correct side of closed meshes.
    pub fn signed_distances(&self, points: &[[f32; 3]], cut_off: f32) -> Vec<f32> {
        self.map_hits(points, cut_off, |p, hit| hit.distance2.sqrt() * self.side(p, hit))
    }

    fn hit(&self, p: [f32; 3], cut_off: f32, guess: Option<u32>) -> Option<Hit> {
        if !p.iter().all(|c| c.is_finite()) || cut_off.is_nan() || cut_off < 0.0 {
            return None;
        }
        self.bvh.closest(p, cut_off * cut_off, guess)
    }

    /// Applies `value` to the closest points. Queries run along a Morton curve, so that each starts with its predecessor's triangle.
    fn map_hits(&self, points: &[[f32; 3]], cut_off: f32, value: impl Fn([f32; 3], &Hit) -> f32 + Sync) -> Vec<f32> {
        map_in_morton_order(points, |run: &[u32]| {
            let mut guess = None;
            let mut out = Vec::with_capacity(run.len());
            for &i in run {
                let p = points[i as usize];
                let hit = self.hit(p, cut_off, guess);
                guess = hit.map(|h| h.slot).or(guess);
                out.push(match hit {
                    Some(hit) => value(p, &hit),
                    None if p.iter().all(|c| c.is_finite()) => f32::INFINITY,
                    None => f32::NAN,
                });
            }
            out
        })
    }

    /// 1 in front of the surface, -1 behind it.
    fn side(&self, p: [f32; 3], hit: &Hit) -> f32 {
        let limit = hit.distance2 * (1.0 + 1e-4) + 1e-12;
        let (mut steepest, mut side) = (-1.0f32, 1.0f32);
        self.bvh.visit(p, limit, |slot, point, distance2, _| {
            if distance2 > limit {
                return;
            }
            let [a, b, c] = self.bvh.corners(slot);
            let normal = vec3::unit(vec3::cross(vec3::sub(b, a), vec3::sub(c, a)));
            let height = vec3::dot(normal, vec3::unit(vec3::sub(p, point)));
            if height.abs() > steepest {
                (steepest, side) = (height.abs(), if height < 0.0 { -1.0 } else { 1.0 });
            }
        });
        side
    }
}

/// Distances of `points` to `mesh`, metres, by [`MeshIndex::distances`].
///
/// # Errors
/// [`EvalError::Empty`] when the mesh has no finite triangle.
pub fn mesh_distances(points: &[[f32; 3]], mesh: &MeshView<'_>, cut_off: f32) -> Result<Vec<f32>> {
    Ok(MeshIndex::new(mesh)?.distances(points, cut_off))
}

/// Points distributed evenly over a mesh, about `per_square_metre`; deterministic. Use them for distances from a mesh to something else.
pub fn sample_surface(mesh: &MeshView<'_>, per_square_metre: f64) -> Vec<[f32; 3]> {
    // A golden-ratio sequence fills triangles evenly; the fraction of a sample left over carries over to the next triangle.
    const STEP: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_3];
    let (mut out, mut due, mut n) = (Vec::new(), 0.5, 0u64);
    for i in (0..mesh.triangles().len()).filter(|&i| mesh.is_finite(i)) {
        let [a, b, c] = mesh.corners(i);
        let (ab, ac) = (vec3::sub(b, a), vec3::sub(c, a));
        let normal = vec3::cross(ab, ac);
        due += 0.5 * f64::from(vec3::dot(normal, normal)).sqrt() * per_square_metre.max(0.0);
        while due >= 1.0 {
            due -= 1.0;
            n += 1;
            let (mut u, mut v) = ((n as f64 * STEP[0]).fract() as f32, (n as f64 * STEP[1]).fract() as f32);
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            out.push(std::array::from_fn(|k| a[k] + u * ab[k] + v * ac[k]));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::triangle_bvh::closest_point;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = [f32; 3]> {
        [-2.0f32..2.0, -2.0f32..2.0, -2.0f32..2.0]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Compares with a dense sampling of the triangle.
        #[test]
        fn closest_point_of_a_triangle_is_closer_than_samples(t in [point(), point(), point()], p in point()) {
            let c = closest_point(t, p);
            let d = |a: [f32; 3]| vec3::dot(vec3::sub(a, p), vec3::sub(a, p)).sqrt();
            let mut sampled = f32::INFINITY;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (u, v) = (i as f32 / 60.0, j as f32 / 60.0);
                    sampled = sampled.min(d(std::array::from_fn(|k| t[0][k] + u * (t[1][k] - t[0][k]) + v * (t[2][k] - t[0][k]))));
                }
            }
            prop_assert!(d(c) <= sampled + 1e-4);
            prop_assert!(d(c) >= sampled - 0.12, "{} {sampled}", d(c));
        }

        #[test]
        fn hierarchy_agrees_with_brute_force(
            vertices in prop::collection::vec(point(), 3..60),
            corners in prop::collection::vec([0usize..1000, 0usize..1000, 0usize..1000], 1..200),
            queries in prop::collection::vec(point(), 1..50),
            cut_off in 0.05f32..4.0,
        ) {
            let triangles: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|v| (v % vertices.len()) as u32)).collect();
            let mesh = MeshView::new(&vertices, &triangles).unwrap();
            let index = MeshIndex::new(&mesh).unwrap();
            for (q, d) in queries.iter().zip(index.distances(&queries, cut_off)) {
                let brute = (0..triangles.len()).map(|i| vec3::sub(closest_point(mesh.corners(i), *q), *q)).map(|v| vec3::dot(v, v).sqrt()).fold(f32::INFINITY, f32::min);
                let expected = if brute <= cut_off { brute } else { f32::INFINITY };
                prop_assert!(d == expected || (d - expected).abs() < 1e-5 || (brute - cut_off).abs() < 1e-5, "{d} {expected}");
                if d.is_finite() {
                    let closest = index.closest(*q, cut_off).unwrap();
                    prop_assert!((closest.distance - d).abs() < 1e-6);
                }
            }
        }
    }

    /// A cube of edge 2 around the origin, outside visible.
    fn cube() -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let v = (0..8).map(|i| std::array::from_fn(|k| if i >> k & 1 == 0 { -1.0 } else { 1.0 })).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        (v, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
    }

    proptest! {
        #[test]
        fn signs_of_a_closed_mesh_are_those_of_inside_and_outside(p in point()) {
            let (v, t) = cube();
            let index = MeshIndex::new(&MeshView::new(&v, &t).unwrap()).unwrap();
            let q = p.map(|c| c.abs() - 1.0);
            let outside = q.map(|c| c.max(0.0));
            let exact = vec3::dot(outside, outside).sqrt() + q[0].max(q[1]).max(q[2]).min(0.0);
            prop_assume!(exact.abs() > 1e-4);
            prop_assert!((index.signed_distances(&[p], f32::INFINITY)[0] - exact).abs() < 1e-5);
        }
    }

    #[test]
    fn points_that_are_not_finite_and_meshes_without_triangles_are_said_so() {
        let (v, t) = cube();
        let index = MeshIndex::new(&MeshView::new(&v, &t).unwrap()).unwrap();
        let d = index.distances(&[[f32::NAN, 0.0, 0.0], [9.0, 0.0, 0.0], [1.5, 0.0, 0.0]], 2.0);
        assert!(d[0].is_nan() && d[1] == f32::INFINITY && (d[2] - 0.5).abs() < 1e-6);
        let nothing = MeshView::new(&v, &[]).unwrap();
        assert!(matches!(MeshIndex::new(&nothing), Err(EvalError::Empty { .. })));
    }

    #[test]
    fn surface_samples_lie_on_the_mesh_with_the_requested_density() {
        let (v, t) = cube();
        let mesh = MeshView::new(&v, &t).unwrap();
        let samples = sample_surface(&mesh, 100.0);
        assert!(samples.len().abs_diff(2400) <= 1, "{}", samples.len());
        let distances = mesh_distances(&samples, &mesh, 1.0).unwrap();
        assert!(distances.iter().all(|d| *d < 1e-6));
        let upper = samples.iter().filter(|p| p[2] > 0.999).count();
        assert!(upper.abs_diff(400) <= 1);
    }
}
