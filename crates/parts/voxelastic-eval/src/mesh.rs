//! A borrowed triangle mesh with validated indices.

use crate::{EvalError, error::Result};
use voxelastic::geometry::Aabb;

/// A triangle mesh in some frame, in metres. Triangles are counter-clockwise seen from the outside (the free side).
#[derive(Clone, Copy, Debug)]
pub struct MeshView<'a> {
    vertices: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    normals: Option<&'a [[f32; 3]]>,
}

impl<'a> MeshView<'a> {
    /// Borrows a mesh of `vertices` (metres) and `triangles` (indices of vertices).
    ///
    /// # Errors
    /// [`EvalError::BadIndex`] when a triangle refers to a vertex that does not exist; [`EvalError::Setting`] beyond 2^31 triangles.
    pub fn new(vertices: &'a [[f32; 3]], triangles: &'a [[u32; 3]]) -> Result<Self> {
        if triangles.len() >= 1 << 31 {
            return Err(EvalError::Setting { setting: "number of triangles", value: triangles.len() as f64, must: "below 2^31" });
        }
        for (i, t) in triangles.iter().enumerate() {
            if let Some(&v) = t.iter().find(|&&v| v as usize >= vertices.len()) {
                return Err(EvalError::BadIndex { triangle: i, vertex: v, vertices: vertices.len() });
            }
        }
        Ok(Self { vertices, triangles, normals: None })
    }

    /// Adds one unit normal per vertex, pointing to the free side; without them surfaces are shaded flat.
    ///
    /// # Errors
    /// [`EvalError::Length`] unless there is one normal per vertex.
    pub fn with_normals(self, normals: &'a [[f32; 3]]) -> Result<Self> {
        if normals.len() != self.vertices.len() {
            return Err(EvalError::Length { what: "normals", got: normals.len(), expected: self.vertices.len() });
        }
        Ok(Self { normals: Some(normals), ..self })
    }

    /// The vertices, metres.
    pub fn vertices(&self) -> &'a [[f32; 3]] {
        self.vertices
    }

    /// The triangles, as indices of vertices.
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    /// The vertex normals, where given.
    pub fn normals(&self) -> Option<&'a [[f32; 3]]> {
        self.normals
    }

    /// Corners of triangle `i`.
    #[inline]
    pub fn corners(&self, i: usize) -> [[f32; 3]; 3] {
        self.triangles[i].map(|v| self.vertices[v as usize])
    }

    /// Whether triangle `i` has only finite corners.
    #[inline]
    pub fn is_finite(&self, i: usize) -> bool {
        self.corners(i).iter().flatten().all(|c| c.is_finite())
    }

    /// Box around the finite vertices.
    pub fn bounds(&self) -> Aabb {
        bounds(self.vertices)
    }
}

/// Box around the finite points of `points`.
pub fn bounds(points: &[[f32; 3]]) -> Aabb {
    let mut aabb = Aabb::default();
    points.iter().filter(|p| p.iter().all(|c| c.is_finite())).for_each(|p| aabb.add(*p));
    aabb
}

/// Area-weighted vertex normals from the winding of the triangles; zero where a vertex belongs to no triangle.
pub fn vertex_normals(mesh: &MeshView<'_>) -> Vec<[f32; 3]> {
    let mut sums = vec![[0.0f32; 3]; mesh.vertices.len()];
    for (i, t) in mesh.triangles.iter().enumerate().filter(|(i, _)| mesh.is_finite(*i)) {
        let [a, b, c] = mesh.corners(i);
        let n = crate::vec3::cross(crate::vec3::sub(b, a), crate::vec3::sub(c, a));
        for &v in t {
            let s = &mut sums[v as usize];
            (0..3).for_each(|k| s[k] += n[k]);
        }
    }
    sums.iter().map(|n| crate::vec3::unit(*n)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangle_with_a_missing_vertex_is_rejected() {
        let error = MeshView::new(&[[0.0; 3]; 3], &[[0, 1, 2], [0, 1, 3]]).unwrap_err();
        assert!(matches!(error, EvalError::BadIndex { triangle: 1, vertex: 3, vertices: 3 }));
    }

    #[test]
    fn normals_follow_the_winding_and_bounds_ignore_nan() {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [f32::NAN, 9.0, 9.0]];
        let mesh = MeshView::new(&vertices, &[[0, 1, 2]]).unwrap();
        assert_eq!(vertex_normals(&mesh)[..3], [[0.0, 0.0, 1.0]; 3]);
        assert_eq!(mesh.bounds().max, [1.0, 1.0, 0.0]);
    }
}
