//! A triangle mesh with shared vertices.

use crate::geometry::Rigid;
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// A triangle mesh; vertices are shared between triangles. Its frame is that of the field or atlas it was extracted from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, metres.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals per vertex, towards free space.
    pub normals: Vec<[f32; 3]>,
    /// Intensity per vertex, 0 to 255; empty if the map has none.
    pub intensities: Vec<u8>,
    /// Colour per vertex, sRGB; empty if the map has none.
    pub colours: Vec<[u8; 3]>,
    /// Integration scale per vertex, 0 to 3 (of the finer of the two voxels between which it lies).
    pub scales: Vec<u8>,
    /// Vertex indices of each triangle, counter-clockwise seen from free space.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Normalises the normals of the vertices from `first` on; zero becomes +z.
    pub(super) fn normalise_from(&mut self, first: usize) {
        self.normals[first..].par_chunks_mut(1024).for_each(|normals| dispatch(Normalise { normals }));
    }

    /// Adds intensities and colours of the vertices from `first` on, if any. Submaps and blocks without intensity or colour become mid grey if
    /// others have them.
    pub(super) fn append_attributes(&mut self, first: usize, intensities: &[u8], colours: &[[u8; 3]]) {
        append(&mut self.intensities, intensities, first, self.positions.len(), 128);
        append(&mut self.colours, colours, first, self.positions.len(), [128; 3]);
    }

    /// Gives memory back that is not used.
    pub(super) fn shrink_to_fit(&mut self) {
        self.positions.shrink_to_fit();
        self.normals.shrink_to_fit();
        self.intensities.shrink_to_fit();
        self.colours.shrink_to_fit();
        self.scales.shrink_to_fit();
        self.triangles.shrink_to_fit();
    }

    /// Transforms the mesh by `t`.
    pub fn transform(&mut self, t: &Rigid) {
        self.transform_from(0, t);
    }

    /// Transforms the vertices from `first` on by `t`.
    pub(super) fn transform_from(&mut self, first: usize, t: &Rigid) {
        self.positions[first..].par_iter_mut().for_each(|p| *p = t.apply(*p));
        self.normals[first..].par_iter_mut().for_each(|n| *n = t.rotate(*n));
    }

    /// Appends `other`, transformed by `t`.
    pub fn append(&mut self, other: &Mesh, t: &Rigid) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions.iter().map(|&p| t.apply(p)));
        self.normals.extend(other.normals.iter().map(|&n| t.rotate(n)));
        self.append_attributes(first as usize, &other.intensities, &other.colours);
        self.scales.extend_from_slice(&other.scales);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
    }
}

/// Appends `values` for the vertices from `first` to `end`, with `unknown` for missing ones; nothing if there are no values at all.
fn append<V: Copy>(all: &mut Vec<V>, values: &[V], first: usize, end: usize, unknown: V) {
    if !all.is_empty() || !values.is_empty() {
        all.resize(first, unknown);
        all.extend_from_slice(values);
        all.resize(end, unknown);
    }
}

/// Normals per vector.
const LANES: usize = 16;

struct Normalise<'a> {
    normals: &'a mut [[f32; 3]],
}

impl Kernel for Normalise<'_> {
    #[inline(always)]
    fn run(self) {
        for normals in self.normals.chunks_mut(LANES) {
            let mut lanes = [[0f32; LANES]; 3];
            for (i, n) in normals.iter().enumerate() {
                [lanes[0][i], lanes[1][i], lanes[2][i]] = *n;
            }
            let [x, y, z] = &mut lanes;
            for i in 0..LANES {
                let length = (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
                let known = length > 0.0;
                (x[i], y[i], z[i]) = (x[i] / length, y[i] / length, z[i] / length);
                (x[i], y[i], z[i]) = (if known { x[i] } else { 0.0 }, if known { y[i] } else { 0.0 }, if known { z[i] } else { 1.0 });
            }
            for (i, n) in normals.iter_mut().enumerate() {
                *n = [lanes[0][i], lanes[1][i], lanes[2][i]];
            }
        }
    }
}
