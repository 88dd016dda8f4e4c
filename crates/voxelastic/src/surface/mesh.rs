//! A triangle mesh with shared vertices.

/// A triangle mesh; vertices are shared between triangles. The frame is that of what it was extracted from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, metres.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals per vertex, towards free space.
    pub normals: Vec<[f32; 3]>,
    /// Strength of return per vertex, 0 to 255; empty when the map has none.
    pub shades: Vec<u8>,
    /// Integration scale per vertex, 0 to 3 (the finer of the two voxels that it lies between).
    pub scales: Vec<u8>,
    /// Vertex indices of each triangle, counter-clockwise seen from free space.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Drops vertices that no triangle uses; the order of the others stays.
    pub(super) fn drop_unused_vertices(&mut self) {
        let mut index = vec![0u32; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&v| index[v as usize] = 1);
        let mut kept = 0;
        for (v, slot) in index.iter_mut().enumerate() {
            if *slot == 1 {
                *slot = kept;
                let k = kept as usize;
                self.positions[k] = self.positions[v];
                self.scales[k] = self.scales[v];
                if !self.shades.is_empty() {
                    self.shades[k] = self.shades[v];
                }
                kept += 1;
            }
        }
        self.positions.truncate(kept as usize);
        self.scales.truncate(kept as usize);
        self.shades.truncate(kept as usize);
        self.triangles.iter_mut().flatten().for_each(|v| *v = index[*v as usize]);
    }

    /// Sets each vertex normal to the mean of its triangles' normals, weighted by their areas.
    pub(super) fn compute_normals(&mut self) {
        let mut normals = vec![[0f32; 3]; self.positions.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|v| self.positions[v as usize]);
            let (u, v): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
            let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
            for &vertex in t {
                (0..3).for_each(|k| normals[vertex as usize][k] += n[k]);
            }
        }
        for n in &mut normals {
            let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
            *n = if length > 0.0 { n.map(|c| c / length) } else { [0.0, 0.0, 1.0] };
        }
        self.normals = normals;
    }

    /// Adds the shades, if there are any, of the vertices from `first` on. A map may have submaps, and a submap blocks, with and without
    /// intensity: the latter count as mid grey.
    pub(super) fn append_shades(&mut self, first: usize, shades: &[u8]) {
        if !self.shades.is_empty() || !shades.is_empty() {
            self.shades.resize(first, 128);
            self.shades.extend_from_slice(shades);
            self.shades.resize(self.positions.len(), 128);
        }
    }

    /// Appends `other`, moved by `t`.
    pub fn append(&mut self, other: &Mesh, t: &crate::geometry::Rigid) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions.iter().map(|&p| t.apply(p)));
        self.normals.extend(other.normals.iter().map(|&n| t.rotate(n)));
        self.append_shades(first as usize, &other.shades);
        self.scales.extend_from_slice(&other.scales);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
    }
}
