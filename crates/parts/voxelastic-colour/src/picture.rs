//! Images, and what is seen in a patch of one.

use crate::light::LINEAR;
use rayon::prelude::*;

/// An image, sRGB, row by row from the top.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// `width * height` pixels.
    pub pixels: Vec<[u8; 3]>,
}

/// An image in linear light at half, a quarter, .. of its resolution, so that a patch of any size is one look-up.
pub(crate) struct Pyramid {
    levels: Vec<Level>,
}

struct Level {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Pyramid {
    pub(crate) fn new(picture: &Picture) -> Self {
        let linear = picture.pixels.par_iter().map(|p| p.map(|c| LINEAR[usize::from(c)])).collect();
        let mut levels = vec![Level { width: picture.width, height: picture.height, pixels: linear }];
        while let Some(last) = levels.last().filter(|level| level.width.min(level.height) >= 4) {
            levels.push(last.halved());
        }
        Self { levels }
    }

    /// Mean light of a patch of about `size` pixels around a pixel.
    pub(crate) fn at(&self, pixel: [f64; 2], size: f64) -> [f32; 3] {
        let level = if size > 1.0 { (size.log2() as usize).min(self.levels.len() - 1) } else { 0 };
        let scale = (1u32 << level) as f64;
        // Pixels have their centres at whole numbers, at each level.
        self.levels[level].at(pixel.map(|c| (c + 0.5) / scale - 0.5))
    }
}

impl Level {
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mean = |i: usize| {
            let (x, y) = (2 * (i % width), 2 * (i / width));
            let corner = |dx: usize, dy: usize| self.pixels[(y + dy) * self.width + x + dx];
            let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
            std::array::from_fn(|k| 0.25 * (a[k] + b[k] + c[k] + d[k]))
        };
        Self { width, height, pixels: (0..width * height).into_par_iter().map(mean).collect() }
    }

    /// Bilinear; beyond the border its pixels.
    fn at(&self, [x, y]: [f64; 2]) -> [f32; 3] {
        let (x, y) = (x.clamp(0.0, (self.width - 1) as f64), y.clamp(0.0, (self.height - 1) as f64));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
        let p = |x: usize, y: usize| self.pixels[y * self.width + x];
        let [a, b, c, d] = [p(x0, y0), p(x1, y0), p(x0, y1), p(x1, y1)];
        std::array::from_fn(|k| (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_are_means_around_their_pixel() {
        // Light grows to the right, by the same step for each pixel.
        let (width, height) = (64, 32);
        let level = Level { width, height, pixels: (0..width * height).map(|i| [(i % width) as f32; 3]).collect() };
        let mut pyramid = Pyramid { levels: vec![level] };
        for k in 0..3 {
            pyramid.levels.push(pyramid.levels[k].halved());
        }
        for size in [0.5, 1.0, 2.0, 3.9, 4.0, 8.0] {
            let found = pyramid.at([30.25, 16.0], size)[0];
            assert!((found - 30.25).abs() < 1e-4, "{size}: {found}");
        }
        assert_eq!(pyramid.at([-3.0, 99.0], 1.0)[0], 0.0);
    }

    #[test]
    fn a_picture_of_one_colour_has_it_at_all_sizes() {
        let picture = Picture { width: 33, height: 17, pixels: vec![[200, 100, 0]; 33 * 17] };
        let pyramid = Pyramid::new(&picture);
        for size in [1.0, 5.0, 1e9] {
            assert_eq!(pyramid.at([20.0, 10.0], size).map(crate::light::to_srgb), [200, 100, 0]);
        }
    }
}
