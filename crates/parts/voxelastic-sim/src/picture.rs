//! Pictures of worlds and scans, for visual inspection.

use crate::{Hit, SimError, World};
use rayon::prelude::*;
use tiny_skia::{Pixmap, PremultipliedColorU8};
use voxelastic::Cloud;

/// Colours from near to far, or low to high.
const RAMP: [[f64; 3]; 5] = [[68.0, 30.0, 90.0], [50.0, 100.0, 150.0], [40.0, 165.0, 130.0], [150.0, 205.0, 80.0], [250.0, 230.0, 60.0]];

fn ramp(t: f64) -> [f64; 3] {
    let position = t.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let k = (position as usize).min(RAMP.len() - 2);
    std::array::from_fn(|c| RAMP[k][c] + (RAMP[k + 1][c] - RAMP[k][c]) * (position - k as f64))
}

/// A PNG of `width` x `height` pixels from their colours (0 to 255), row by row from the top.
pub(crate) fn png(width: usize, height: usize, colours: &[[f64; 3]]) -> Result<Vec<u8>, SimError> {
    let mut pixmap = Pixmap::new(width as u32, height as u32).ok_or_else(|| SimError::Picture(format!("{width} x {height} pixels")))?;
    for (pixel, colour) in pixmap.pixels_mut().iter_mut().zip(colours) {
        let [r, g, b] = colour.map(|c| c.clamp(0.0, 255.0) as u8);
        *pixel = PremultipliedColorU8::from_rgba(r, g, b, 255).unwrap_or(PremultipliedColorU8::TRANSPARENT);
    }
    pixmap.encode_png().map_err(|e| SimError::Picture(e.to_string()))
}

/// Most pixels of a picture.
const MAX_PIXELS: usize = 50_000_000;

fn check_size(width: usize, height: usize) -> Result<(), SimError> {
    let is_valid = width > 0 && height > 0 && width.saturating_mul(height) <= MAX_PIXELS;
    if is_valid { Ok(()) } else { Err(SimError::Picture(format!("{width} x {height} pixels: it needs some, and at most {MAX_PIXELS}"))) }
}

/// A view from above.
#[derive(Clone, Debug, PartialEq)]
pub struct TopView {
    /// Corner with the smallest x and y, map frame, metres.
    pub low: [f64; 2],
    /// Opposite corner.
    pub high: [f64; 2],
    /// Height of the viewer, metres: below a ceiling it shows the room.
    pub height: f64,
    /// Edge of a pixel, metres.
    pub pixel: f64,
}

impl World {
    /// A PNG of the world from above, x to the right and y up: coloured by height, shaded by slope, with `path` in red.
    /// Pixels whose viewpoint is inside a solid are black.
    ///
    /// # Errors
    /// [`SimError::Picture`] for a picture without pixels or beyond memory.
    pub fn top_view(&self, view: &TopView, path: &[[f64; 2]]) -> Result<Vec<u8>, SimError> {
        let size = |k: usize| ((view.high[k] - view.low[k]) / view.pixel.max(1e-3)).ceil().clamp(0.0, 20_000.0) as usize;
        let (width, height) = (size(0), size(1));
        check_size(width, height)?;
        let height_range = view.height.clamp(1.0, 20.0);
        let mut colours: Vec<[f64; 3]> = (0..height)
            .into_par_iter()
            .flat_map_iter(|row| {
                let eye = move |column: usize| {
                    [view.low[0] + (column as f64 + 0.5) * view.pixel, view.high[1] - (row as f64 + 0.5) * view.pixel, view.height]
                };
                (0..width).map(move |column| {
                    let eye = eye(column);
                    let hit = self.cast(eye, [0.0, 0.0, -1.0], 1e4).filter(|h| h.range > 0.0);
                    hit.map_or([0.0; 3], |h| self.shaded_colour(eye, &h, height_range))
                })
            })
            .collect();
        for p in path {
            let (column, row) = (((p[0] - view.low[0]) / view.pixel) as usize, ((view.high[1] - p[1]) / view.pixel) as usize);
            let inside = p[0] >= view.low[0] && p[1] <= view.high[1] && column < width && row < height;
            if inside {
                colours[row * width + column] = [255.0, 40.0, 40.0];
            }
        }
        png(width, height, &colours)
    }

    fn shaded_colour(&self, eye: [f64; 3], hit: &Hit, height_range: f64) -> [f64; 3] {
        let p = [eye[0], eye[1], eye[2] - hit.range];
        let n = self.normal(hit.solid, p);
        let light = 0.45 + 0.55 * (0.5 * n[0] + 0.3 * n[1] + 0.81 * n[2]).max(0.0);
        ramp(p[2] / height_range).map(|c| c * light)
    }
}

/// A PNG of an organised cloud as an image: ranges in the upper half (logarithmic, near is dark), intensities in the lower half; each row of the scan is
/// `scale` pixels high. Missing returns are black.
///
/// # Errors
/// [`SimError::Picture`] for a cloud without points.
pub fn scan_picture(cloud: &Cloud, scale: usize) -> Result<Vec<u8>, SimError> {
    let (width, rows, scale) = (cloud.width, cloud.height, scale.max(1));
    check_size(width, 2 * rows.saturating_mul(scale))?;
    if width * rows != cloud.len() {
        return Err(SimError::Picture(format!("a grid of {width} x {rows} for {} points", cloud.len())));
    }
    let mut colours = Vec::with_capacity(2 * width * rows * scale);
    for part in 0..2 {
        for row in 0..rows * scale {
            for column in 0..width {
                let index = row / scale * width + column;
                let p = cloud.points[index];
                let range = f64::from(p[0]).hypot(f64::from(p[1])).hypot(f64::from(p[2]));
                let strength = cloud.intensity.as_ref().and_then(|i| i.get(index)).map_or(0.0, |&i| f64::from(i));
                colours.push(match (range.is_finite(), part) {
                    (false, _) => [0.0; 3],
                    (true, 0) => ramp((range / 1.0).ln() / 100f64.ln()),
                    (true, _) => [strength; 3],
                });
            }
        }
    }
    png(width, 2 * rows * scale, &colours)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scene, SimOptions, Simulation};

    fn decode(png: &[u8]) -> Result<Pixmap, SimError> {
        Pixmap::decode_png(png).map_err(|e| SimError::Picture(e.to_string()))
    }

    #[test]
    fn top_view_of_the_room_shows_walls_and_crate() -> Result<(), SimError> {
        let scene = Scene::named("room", 1)?;
        let view = TopView { low: [-6.0, -5.0], high: [6.0, 5.0], height: 2.9, pixel: 0.1 };
        let picture = decode(&scene.world.top_view(&view, &[[0.0, 0.0]])?)?;
        assert_eq!((picture.width(), picture.height()), (120, 100));
        let colour = |x: f64, y: f64| {
            let pixel = picture.pixel(((x + 6.0) / 0.1) as u32, ((5.0 - y) / 0.1) as u32);
            pixel.map_or([0; 3], |p| [p.red(), p.green(), p.blue()])
        };
        assert_eq!(colour(-5.5, 0.0), [0; 3], "inside the wall");
        assert_eq!(colour(0.05, -0.05), [255, 40, 40], "the path");
        assert!(colour(3.4, 2.6)[1] > colour(1.0, 1.0)[1], "the crate is higher than the floor");
        Ok(())
    }

    #[test]
    fn bad_sizes_are_rejected() -> Result<(), SimError> {
        let world = Scene::named("room", 1)?.world;
        for (high, pixel) in [([0.0, 0.0], 0.1), ([f64::NAN, 1.0], 0.1), ([1e9, 1e9], 0.1), ([1.0, 1.0], f64::NAN)] {
            let view = TopView { low: [0.0, 0.0], high, height: 2.0, pixel };
            let outcome = world.top_view(&view, &[[f64::NAN, 0.0], [-1.0, -1.0]]);
            assert!(pixel.is_nan() || matches!(outcome, Err(SimError::Picture(_))));
        }
        let simulation = Simulation::new(SimOptions { columns: Some(64), scans: Some(1), ..SimOptions::of("room") })?;
        let mut cloud = simulation.cloud(0).unwrap_or_default();
        assert_eq!(decode(&scan_picture(&cloud, 2)?)?.height(), 2 * 2 * 64);
        cloud.points.pop();
        assert!(scan_picture(&cloud, 2).is_err() && scan_picture(&Cloud::default(), 2).is_err());
        Ok(())
    }
}
