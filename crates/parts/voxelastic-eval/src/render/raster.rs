//! Rasterisation of one tile with a depth buffer.

use super::geometry::{Bin, Shape};
use super::tiles::TILE;

/// No primitive.
pub(super) const NOTHING: u32 = u32::MAX;

/// The nearest primitive and its `q` at each sample of a tile, row by row.
pub(super) struct Samples {
    pub id: Vec<u32>,
    pub q: Vec<f32>,
}

impl Samples {
    pub fn new() -> Self {
        Self { id: vec![NOTHING; TILE * TILE], q: vec![f32::NEG_INFINITY; TILE * TILE] }
    }

    /// Draws the primitives of tile `tile`, whose first sample is at (`x0`, `y0`).
    pub fn draw(&mut self, bins: &[Bin], tile: usize, x0: usize, y0: usize) {
        self.id.fill(NOTHING);
        self.q.fill(f32::NEG_INFINITY);
        // Positions relative to the tile keep the edge functions exact enough in single precision.
        let local = |p: [f32; 3]| [p[0] - x0 as f32, p[1] - y0 as f32, p[2]];
        for bin in bins {
            for &i in &bin.list[bin.starts[tile] as usize..bin.starts[tile + 1] as usize] {
                let p = &bin.primitives[i as usize];
                match p.shape {
                    Shape::Triangle(c) => self.triangle(p.id, c.map(local)),
                    Shape::Disc(c, r) => self.disc(p.id, local(c), r),
                    Shape::Segment(e, r, on_top) => self.segment(p.id, e.map(local), r, on_top),
                }
            }
        }
    }

    #[inline(always)]
    fn put(&mut self, x: usize, y: usize, id: u32, q: f32) {
        let s = y * TILE + x;
        // Strictly nearer: of two equally near primitives the first in the scene wins, for any number of threads.
        if q > self.q[s] {
            self.q[s] = q;
            self.id[s] = id;
        }
    }

    fn triangle(&mut self, id: u32, c: [[f32; 3]; 3]) {
        let (x, y): ([f64; 3], [f64; 3]) = (c.map(|p| f64::from(p[0])), c.map(|p| f64::from(p[1])));
        let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        // Barycentric coordinates are linear: value at the tile's first sample, and steps right and down.
        let inv = 1.0 / area;
        let (mut at, mut dx, mut dy) = ([0.0f32; 3], [0.0f32; 3], [0.0f32; 3]);
        for k in 0..3 {
            let (a, b) = ((k + 1) % 3, (k + 2) % 3);
            let (ex, ey) = ((y[a] - y[b]) * inv, (x[b] - x[a]) * inv);
            at[k] = ((0.5 - x[a]) * ex + (0.5 - y[a]) * ey) as f32;
            (dx[k], dy[k]) = (ex as f32, ey as f32);
        }
        let q = |w: [f32; 3]| w[0] * c[0][2] + w[1] * c[1][2] + w[2] * c[2][2];
        let (xs, ys) = (span(c.map(|p| p[0])), span(c.map(|p| p[1])));
        for row in ys.0..ys.1 {
            let start: [f32; 3] = std::array::from_fn(|k| at[k] + dy[k] * row as f32);
            for column in xs.0..xs.1 {
                let w: [f32; 3] = std::array::from_fn(|k| start[k] + dx[k] * column as f32);
                // A small overlap leaves no pinholes between neighbours.
                if w[0] >= -1e-5 && w[1] >= -1e-5 && w[2] >= -1e-5 {
                    self.put(column, row, id, q(w));
                }
            }
        }
    }

    fn disc(&mut self, id: u32, c: [f32; 3], r: f32) {
        let (xs, ys) = (span([c[0] - r, c[0] + r, c[0]]), span([c[1] - r, c[1] + r, c[1]]));
        for row in ys.0..ys.1 {
            for column in xs.0..xs.1 {
                let (dx, dy) = (column as f32 + 0.5 - c[0], row as f32 + 0.5 - c[1]);
                if dx * dx + dy * dy <= r * r {
                    self.put(column, row, id, c[2]);
                }
            }
        }
    }

    fn segment(&mut self, id: u32, [a, b]: [[f32; 3]; 2], r: f32, on_top: bool) {
        let d = [b[0] - a[0], b[1] - a[1]];
        let length2 = (d[0] * d[0] + d[1] * d[1]).max(1e-12);
        let xs = span([a[0].min(b[0]) - r, a[0].max(b[0]) + r, a[0]]);
        let ys = span([a[1].min(b[1]) - r, a[1].max(b[1]) + r, a[1]]);
        for row in ys.0..ys.1 {
            for column in xs.0..xs.1 {
                let p = [column as f32 + 0.5 - a[0], row as f32 + 0.5 - a[1]];
                let t = ((p[0] * d[0] + p[1] * d[1]) / length2).clamp(0.0, 1.0);
                let off = [p[0] - t * d[0], p[1] - t * d[1]];
                if off[0] * off[0] + off[1] * off[1] <= r * r {
                    self.put(column, row, id, if on_top { f32::MAX } else { a[2] + (b[2] - a[2]) * t });
                }
            }
        }
    }
}

/// First and one past the last sample of the tile whose centre may lie between the smallest and largest of `c`.
fn span(c: [f32; 3]) -> (usize, usize) {
    let (lo, hi) = (c[0].min(c[1]).min(c[2]), c[0].max(c[1]).max(c[2]));
    let last = (hi - 0.5).ceil().clamp(-1.0, (TILE - 1) as f32);
    // Conversions saturate: far outside the tile the span is empty.
    ((lo - 0.5).floor().max(0.0) as usize, (last + 1.0) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adjacent_triangles_leave_no_pinhole_and_the_nearer_primitive_wins() {
        let mut s = Samples::new();
        let (a, b, c, d) = ([-3.0, -3.0, 1.0], [80.3, -7.0, 1.0], [77.7, 90.1, 1.0], [-20.0, 70.0, 1.0]);
        s.triangle(7, [a, b, c]);
        s.triangle(8, [a, d, c]);
        assert!(s.id.iter().all(|&i| i == 7 || i == 8));
        assert!(s.id.contains(&7) && s.id.contains(&8));
        s.disc(9, [10.0, 10.0, 2.0], 3.0);
        s.disc(10, [10.0, 10.0, 0.5], 9.0);
        assert_eq!(s.id.iter().filter(|&&i| i == 9).count(), 32);
        assert!(!s.id.contains(&10));
    }
}
