//! A triangle mesh with shared vertices.

use rayon::prelude::*;

/// A triangle mesh; vertices are shared between triangles. The frame is that of what it was extracted from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, metres.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals per vertex, towards free space.
    pub normals: Vec<[f32; 3]>,
    /// Strength of return per vertex, 0 to 255; empty when the map has none.
    pub shades: Vec<u8>,
    /// Colour per vertex as the scans had it, sRGB; empty when the map has none.
    pub colours: Vec<[u8; 3]>,
    /// Integration scale per vertex, 0 to 3 (the finer of the two voxels that it lies between).
    pub scales: Vec<u8>,
    /// Vertex indices of each triangle, counter-clockwise seen from free space.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Sets each vertex normal to the mean of its triangles' normals, weighted by their areas. `vertices` and `triangles` are the sizes
    /// of parts in which most triangles have their vertices; they, not the threads, decide the order of the sums.
    pub(super) fn compute_normals(&mut self, vertices: &[usize], triangles: &[usize]) {
        let mut normals = vec![[0f32; 3]; self.positions.len()];
        let starts = |sizes: &[usize]| sizes.iter().scan(0, |start, size| Some(std::mem::replace(start, *start + size))).collect::<Vec<_>>();
        let (first_vertex, first_triangle) = (starts(vertices), starts(triangles));
        let spilt: Vec<Vec<(u32, [f32; 3])>> = super::join::cut(&mut normals, vertices)
            .into_par_iter()
            .enumerate()
            .map(|(part, normals)| {
                let mut spilt = Vec::new();
                for t in &self.triangles[first_triangle[part]..][..triangles[part]] {
                    let n = self.area_normal(t);
                    for &vertex in t {
                        match normals.get_mut((vertex as usize).wrapping_sub(first_vertex[part])) {
                            Some(normal) => *normal = add(*normal, n),
                            None => spilt.push((vertex, n)),
                        }
                    }
                }
                spilt
            })
            .collect();
        for (vertex, n) in spilt.into_iter().flatten() {
            normals[vertex as usize] = add(normals[vertex as usize], n);
        }
        normals.par_iter_mut().for_each(|n| {
            let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
            *n = if length > 0.0 { n.map(|c| c / length) } else { [0.0, 0.0, 1.0] };
        });
        self.normals = normals;
    }

    /// Normal of a triangle, as long as twice its area.
    #[inline(always)]
    fn area_normal(&self, triangle: &[u32; 3]) -> [f32; 3] {
        let [a, b, c] = triangle.map(|v| self.positions[v as usize]);
        let (u, v): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    }

    /// Adds what vertices from `first` on bear, if anything. A map may have submaps, and a submap blocks, with and without intensity or
    /// colour: those without count as mid grey.
    fn append_marks(&mut self, first: usize, shades: &[u8], colours: &[[u8; 3]]) {
        append(&mut self.shades, shades, first, self.positions.len(), 128);
        append(&mut self.colours, colours, first, self.positions.len(), [128; 3]);
    }

    /// Moves the mesh by `t`.
    pub fn transform(&mut self, t: &crate::geometry::Rigid) {
        self.positions.par_iter_mut().for_each(|p| *p = t.apply(*p));
        self.normals.par_iter_mut().for_each(|n| *n = t.rotate(*n));
    }

    /// Appends `other`, moved by `t`.
    pub fn append(&mut self, other: &Mesh, t: &crate::geometry::Rigid) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions.iter().map(|&p| t.apply(p)));
        self.normals.extend(other.normals.iter().map(|&n| t.rotate(n)));
        self.append_marks(first as usize, &other.shades, &other.colours);
        self.scales.extend_from_slice(&other.scales);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
    }
}

#[inline(always)]
fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Appends `values` for the vertices from `first` to `end`, with `unknown` for those that have none; nothing if nobody has any.
fn append<V: Copy>(all: &mut Vec<V>, values: &[V], first: usize, end: usize, unknown: V) {
    if !all.is_empty() || !values.is_empty() {
        all.resize(first, unknown);
        all.extend_from_slice(values);
        all.resize(end, unknown);
    }
}
