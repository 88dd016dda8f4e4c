//! Depth images of a mesh: how far the camera sees at each pixel.
//!
//! The mesh is drawn with a margin: besides its triangles, each vertex is a square as wide as the mesh may be off, so that the outline of a thing in front
//! covers what its true outline may cover. What is compared with the depth allows for as much.

use crate::camera::CameraModel;
use rayon::prelude::*;

/// Rows that one thread draws.
const BAND: usize = 32;

/// Range along the ray of each pixel, metres; infinite where nothing is.
pub(crate) struct DepthImage {
    width: usize,
    height: usize,
    ranges: Vec<f32>,
}

/// A vertex in the image: pixel coordinates and range.
pub(crate) type Corner = [f32; 3];

impl DepthImage {
    /// Draws triangles, and vertices as squares of `margin` metres to each side and a pixel more. What is nearer wins, so that the order does not matter.
    pub(crate) fn draw(camera: &CameraModel, triangles: &[[Corner; 3]], vertices: &[Corner], margin: f32) -> Self {
        let (width, height) = (camera.width(), camera.height());
        let mut ranges = vec![f32::INFINITY; width * height];
        ranges.par_chunks_mut(width * BAND).enumerate().for_each(|(band, rows)| {
            let first = (band * BAND) as f32;
            let last = first + (rows.len() / width) as f32 - 1.0;
            for corners in triangles {
                let (low, high) = extent(corners.map(|c| c[1]));
                if high >= first && low <= last {
                    draw(rows, width, first, last, corners);
                }
            }
            for [u, v, range] in vertices {
                let half = margin * camera.focal()[0] as f32 / range.max(1e-3) + 1.0;
                if v + half >= first && v - half <= last {
                    let rows_of = (v - half).ceil().max(first) as usize..=(v + half).floor().min(last) as usize;
                    let (left, right) = ((u - half).ceil().max(0.0) as usize, ((u + half).floor() + 1.0).clamp(0.0, width as f32) as usize);
                    for row in rows_of.filter(|_| left < right) {
                        let start = (row - first as usize) * width;
                        rows[start + left..start + right].iter_mut().for_each(|r| *r = r.min(*range));
                    }
                }
            }
        });
        Self { width, height, ranges }
    }

    /// Range at a pixel of the image.
    pub(crate) fn at(&self, pixel: [f64; 2]) -> f32 {
        let column = (pixel[0].round().max(0.0) as usize).min(self.width - 1);
        let row = (pixel[1].round().max(0.0) as usize).min(self.height - 1);
        self.ranges[row * self.width + column]
    }
}

fn extent(c: [f32; 3]) -> (f32, f32) {
    (c[0].min(c[1]).min(c[2]), c[0].max(c[1]).max(c[2]))
}

/// Draws the part of a triangle between rows `first` and `last`. The range is interpolated in the image: triangles are small.
fn draw(rows: &mut [f32], width: usize, first: f32, last: f32, corners: &[Corner; 3]) {
    let (x, y): ([f64; 3], [f64; 3]) = (corners.map(|c| f64::from(c[0])), corners.map(|c| f64::from(c[1])));
    let area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
    if area == 0.0 || !area.is_finite() {
        return;
    }
    let (low, high) = extent(corners.map(|c| c[0]));
    if high < 0.0 || low > (width - 1) as f32 {
        return;
    }
    let columns = low.ceil().max(0.0) as usize..=high.floor().min((width - 1) as f32) as usize;
    let (low, high) = extent(corners.map(|c| c[1]));
    let (from, to) = (low.ceil().max(first), high.floor().min(last));
    if from > to {
        return;
    }
    for row in from as usize..=to as usize {
        let line = &mut rows[(row - first as usize) * width..][..width];
        for column in columns.clone() {
            let weight = |k: usize| {
                let (a, b) = ((k + 1) % 3, (k + 2) % 3);
                ((x[a] - column as f64) * (y[b] - row as f64) - (x[b] - column as f64) * (y[a] - row as f64)) / area
            };
            let w = [weight(0), weight(1), weight(2)];
            // A small overlap leaves no pinholes between neighbours.
            if w.iter().all(|w| *w >= -1e-6) {
                let range = (0..3).map(|k| w[k] * f64::from(corners[k][2])).sum::<f64>() as f32;
                line[column] = line[column].min(range);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Distortion;

    #[test]
    fn the_nearer_triangle_wins_and_neighbours_leave_no_pinhole() {
        let camera = CameraModel::new([80, 70], [50.0; 2], [40.0, 35.0], Distortion::NONE).unwrap();
        let (a, b, c, d) = ([-9.0, -9.0, 4.0], [90.3, -7.0, 4.0], [87.7, 90.1, 4.0], [-20.0, 80.0, 4.0]);
        let near = [[10.0, 10.0, 1.0], [30.0, 10.0, 1.0], [10.0, 30.0, 3.0]];
        let off = [[-30.0, -5.0, 1.0], [-3.0, 10.0, 1.0], [-10.0, 30.0, 3.0]];
        let image = DepthImage::draw(&camera, &[[a, b, c], [a, d, c], near, off], &[], 0.0);
        assert!(image.ranges.iter().all(|r| (*r - 4.0).abs() < 1e-4 || *r < 3.01));
        assert_eq!(image.at([12.2, 11.6]), 1.2);
        assert!((image.at([79.4, 69.4]) - 4.0).abs() < 1e-4 && (image.at([0.0, 0.0]) - 4.0).abs() < 1e-4);
        // A slow reference: the nearest triangle at each pixel, by areas of the three parts.
        for (row, column) in (0..70).flat_map(|row| (0..80).map(move |column| (row, column))) {
            let inside = (column - 10) + (row - 10) <= 20 && column >= 10 && row >= 10;
            let found = image.ranges[(row * 80 + column) as usize];
            assert_eq!(found < 3.01, inside, "{row} {column}: {found}");
        }
    }

    #[test]
    fn vertices_are_squares_of_the_margin() {
        let camera = CameraModel::new([80, 70], [50.0; 2], [40.0, 35.0], Distortion::NONE).unwrap();
        // 0.1 m at 1 m are five pixels, and one more; the second is cut by the border, the third is not in the image.
        let vertices = [[20.0, 33.0, 1.0], [79.0, 69.0, 2.0], [-30.0, 20.0, 1.0]];
        let image = DepthImage::draw(&camera, &[], &vertices, 0.1);
        for (row, column) in (0..70).flat_map(|row: i32| (0..80).map(move |column: i32| (row, column))) {
            let near = (column - 20).abs().max((row - 33).abs()) <= 6;
            let far = (column - 79).abs().max((row - 69).abs()) <= 3;
            let expected = if near {
                1.0
            } else if far {
                2.0
            } else {
                f32::INFINITY
            };
            assert_eq!(image.ranges[(row * 80 + column) as usize], expected, "{row} {column}");
        }
    }
}
