//! Encoding of meshes as bytes that compress well and are fast to decode in a page.
//!
//! A mesh is cut into chunks of at most 65,535 vertices. In each, vertices are numbered in the order of their first use by a triangle, so that most
//! corners are either new or recent: the code of a corner is its distance to the newest vertex, 0 for a new one. Coordinates are differences
//! from vertex to vertex. Every stream is split into its low and its high bytes. The layout, chunk by chunk:
//!
//! | bytes | what |
//! | --- | --- |
//! | 6 v | x, y, z: differences of the u16 coordinates, zigzag; low bytes of x, high bytes of x, low bytes of y, .. |
//! | 2 v | normals, octahedral: all first numbers, all second ones |
//! | v | intensities (0 where unknown) |
//! | v | scales |
//! | v | errors: 0 to 254 from none to the largest shown, 255 for unknown |
//! | 3 v | colours, in surfaces that have some: all reds, all greens, all blues |
//! | 6 t | corners: low bytes, high bytes |

use crate::surface::Surface;
use serde::Serialize;

/// Most vertices of a chunk: 16-bit indices, of which WebGL reserves the last.
const MAX_VERTICES: usize = 65_535;

/// Sizes of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Chunk {
    /// Vertices.
    pub v: usize,
    /// Triangles.
    pub t: usize,
}

/// A chunk under construction.
struct Builder {
    /// Vertices of the surface, in their order in the chunk.
    vertices: Vec<u32>,
    /// Codes of the corners.
    codes: Vec<u16>,
    /// Number in this chunk by vertex of the surface, with the chunk's serial number.
    index: Vec<(u32, u16)>,
    serial: u32,
}

/// Appends the surface's chunks to `bytes`.
pub(crate) fn chunks(surface: &Surface, origin: [f32; 3], step: f32, error_max: f32, bytes: &mut Vec<u8>) -> Vec<Chunk> {
    let mut out = Vec::new();
    let mut builder = Builder { vertices: Vec::new(), codes: Vec::new(), index: vec![(0, 0); surface.positions.len()], serial: 1 };
    for t in &surface.triangles {
        if builder.vertices.len() + 3 > MAX_VERTICES {
            out.push(builder.finish(surface, origin, step, error_max, bytes));
        }
        t.iter().for_each(|&v| builder.corner(v));
    }
    if !builder.codes.is_empty() {
        out.push(builder.finish(surface, origin, step, error_max, bytes));
    }
    out
}

impl Builder {
    fn corner(&mut self, v: u32) {
        let newest = self.vertices.len() as u16;
        let (serial, number) = self.index[v as usize];
        if serial == self.serial {
            self.codes.push(newest - number);
        } else {
            self.index[v as usize] = (self.serial, newest);
            self.vertices.push(v);
            self.codes.push(0);
        }
    }

    fn finish(&mut self, surface: &Surface, origin: [f32; 3], step: f32, error_max: f32, bytes: &mut Vec<u8>) -> Chunk {
        let chunk = Chunk { v: self.vertices.len(), t: self.codes.len() / 3 };
        let at = |v: &u32| *v as usize;
        for (k, &low) in origin.iter().enumerate() {
            let mut last = 0;
            let differences: Vec<u16> = self
                .vertices
                .iter()
                .map(|v| {
                    let here = ((surface.positions[at(v)][k] - low) / step).round().clamp(0.0, 65535.0) as u16;
                    let difference = here.wrapping_sub(last) as i16;
                    last = here;
                    zigzag(difference)
                })
                .collect();
            push_byte_planes(&differences, bytes);
        }
        let normals: Vec<[u8; 2]> = self.vertices.iter().map(|v| octahedral(surface.normals[at(v)])).collect();
        (0..2).for_each(|k| bytes.extend(normals.iter().map(|n| n[k])));
        bytes.extend(self.vertices.iter().map(|v| surface.intensities.get(at(v)).copied().unwrap_or(0)));
        bytes.extend(self.vertices.iter().map(|v| surface.scales.get(at(v)).copied().unwrap_or(0)));
        bytes.extend(self.vertices.iter().map(|v| surface.errors.get(at(v)).map_or(255, |e| error_code(*e, error_max))));
        if !surface.colours.is_empty() {
            (0..3).for_each(|k| bytes.extend(self.vertices.iter().map(|v| surface.colours[at(v)][k])));
        }
        push_byte_planes(&self.codes, bytes);
        self.vertices.clear();
        self.codes.clear();
        self.serial += 1;
        chunk
    }
}

/// Maps small differences of either sign to small numbers.
fn zigzag(d: i16) -> u16 {
    ((d << 1) ^ (d >> 15)) as u16
}

/// Low bytes, then high bytes.
fn push_byte_planes(values: &[u16], bytes: &mut Vec<u8>) {
    bytes.extend(values.iter().map(|v| *v as u8));
    bytes.extend(values.iter().map(|v| (v >> 8) as u8));
}

/// A unit vector as two bytes (Meyer et al. 2010): the octahedron unfolded into a square.
fn octahedral(n: [f32; 3]) -> [u8; 2] {
    let sum = n.iter().map(|c| c.abs()).sum::<f32>().max(1e-12);
    let [x, y, z] = n.map(|c| c / sum);
    let sign = |c: f32| if c < 0.0 { -1.0 } else { 1.0 };
    let folded = if z < 0.0 { [(1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)] } else { [x, y] };
    folded.map(|c| ((c * 0.5 + 0.5) * 255.0).round() as u8)
}

fn error_code(error: f32, most: f32) -> u8 {
    if error.is_nan() { 255 } else { (error.abs() / most.max(1e-9) * 254.0).round().min(254.0) as u8 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decimate::tests::slab;
    use proptest::prelude::*;

    /// The decoder of the page in Rust: positions in steps, and triangles of the chunk's vertex numbers.
    fn unpacked(chunks: &[Chunk], mut bytes: &[u8]) -> Vec<(Vec<[u16; 3]>, Vec<[u16; 3]>)> {
        let mut take = |n: usize| {
            let (head, rest) = bytes.split_at(n);
            bytes = rest;
            head
        };
        chunks
            .iter()
            .map(|c| {
                let mut positions = vec![[0u16; 3]; c.v];
                for k in 0..3 {
                    let (low, high) = (take(c.v), take(c.v));
                    let mut here = 0u16;
                    for (i, p) in positions.iter_mut().enumerate() {
                        let z = u16::from(low[i]) | u16::from(high[i]) << 8;
                        here = here.wrapping_add((z >> 1) ^ 0u16.wrapping_sub(z & 1));
                        p[k] = here;
                    }
                }
                take(5 * c.v);
                let (low, high) = (take(3 * c.t), take(3 * c.t));
                let mut newest = 0u16;
                let corners: Vec<u16> = (0..3 * c.t)
                    .map(|i| {
                        let corner = newest - (u16::from(low[i]) | u16::from(high[i]) << 8);
                        newest += u16::from(corner == newest);
                        corner
                    })
                    .collect();
                (positions, corners.chunks(3).map(|t| [t[0], t[1], t[2]]).collect())
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn round_trip(
            positions in prop::collection::vec([0.0f32..6.5, 0.0f32..6.5, 0.0f32..6.5], 3..200),
            corners in prop::collection::vec([0usize..1000, 0usize..1000, 0usize..1000], 1..300),
        ) {
            let n = positions.len();
            let triangles: Vec<[u32; 3]> = corners.iter().map(|t| t.map(|v| (v % n) as u32)).collect();
            let surface = Surface { normals: vec![[0.0, 0.0, 1.0]; n], positions, triangles, ..Surface::default() };
            let mut bytes = Vec::new();
            let packed = chunks(&surface, [0.0; 3], 1e-4, 0.1, &mut bytes);
            let back = unpacked(&packed, &bytes);
            let found: Vec<[[u16; 3]; 3]> = back.iter().flat_map(|(p, t)| t.iter().map(|t| t.map(|v| p[v as usize]))).collect();
            let wanted: Vec<[[u16; 3]; 3]> = surface.triangles.iter()
                .map(|t| t.map(|v| surface.positions[v as usize].map(|c| (c / 1e-4).round() as u16))).collect();
            prop_assert_eq!(found, wanted);
        }

        #[test]
        fn octahedral_normals_are_accurate(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let length = (x * x + y * y + z * z).sqrt();
            prop_assume!(length > 0.1);
            let n = [x, y, z].map(|c| c / length);
            let [u, v] = octahedral(n).map(|c| f32::from(c) / 127.5 - 1.0);
            let w = 1.0 - u.abs() - v.abs();
            let t = (-w).max(0.0);
            let m = [u - t.copysign(u), v - t.copysign(v), w];
            let m_length = m.iter().map(|c| c * c).sum::<f32>().sqrt();
            let cosine: f32 = (0..3).map(|k| n[k] * m[k] / m_length).sum();
            prop_assert!(cosine > 0.9995, "{cosine}");
        }
    }

    #[test]
    fn large_meshes_are_split_into_chunks_without_loss() {
        let surface = slab(240);
        let mut bytes = Vec::new();
        let packed = chunks(&surface, [0.0, 0.0, -1.0], 1e-3, 0.1, &mut bytes);
        assert!(packed.len() > 1 && packed.iter().all(|c| c.v <= MAX_VERTICES));
        assert_eq!(packed.iter().map(|c| c.t).sum::<usize>(), surface.triangles.len());
        assert_eq!(bytes.len(), packed.iter().map(|c| 14 * c.v + 6 * c.t).sum::<usize>());
    }

    #[test]
    fn error_codes() {
        assert_eq!([0.0, -0.05, 0.1, 9.0, f32::INFINITY, f32::NAN].map(|e| error_code(e, 0.1)), [0, 127, 254, 254, 254, 255]);
    }
}
