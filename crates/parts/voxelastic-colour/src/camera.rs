//! Camera models: a pinhole with the distortions that ROS and OpenCV know.
//!
//! Camera frame C: x to the right of the image, y down, z ahead. Pixel coordinates: the centre of the first pixel is (0, 0).

use crate::{ColourError, Result};

/// Distortion of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// Brown's: `k1 k2 p1 p2 k3`, and the denominator `k4 k5 k6` of the rational model (ROS: `plumb_bob`, `rational_polynomial`; OpenCV: the
    /// coefficients of `projectPoints`).
    PlumbBob([f64; 8]),
    /// Of fisheye lenses, a polynomial of the angle off the axis: `k1 k2 k3 k4` (ROS: `equidistant`; OpenCV: `fisheye`).
    Equidistant([f64; 4]),
}

impl Distortion {
    /// That of a pinhole.
    pub const NONE: Self = Self::PlumbBob([0.0; 8]);

    fn coefficients(&self) -> &[f64] {
        match self {
            Self::PlumbBob(k) => k,
            Self::Equidistant(k) => k,
        }
    }

    /// Distance from the centre in a normalised image without tangential distortion, by that without distortion (of [`Self::PlumbBob`]) or the angle off
    /// the axis.
    fn radial(&self, x: f64) -> f64 {
        let x2 = x * x;
        match self {
            Self::PlumbBob([k1, k2, _, _, k3, k4, k5, k6]) => x * (1.0 + x2 * (k1 + x2 * (k2 + x2 * k3))) / (1.0 + x2 * (k4 + x2 * (k5 + x2 * k6))),
            Self::Equidistant([k1, k2, k3, k4]) => x * (1.0 + x2 * (k1 + x2 * (k2 + x2 * (k3 + x2 * k4)))),
        }
    }

    /// Up to where [`radial`](Self::radial) grows. Beyond that, the polynomial would fold what the lens does not see back into the image.
    fn growing_limit(&self) -> f64 {
        const STEPS: usize = 2000;
        let most = match self {
            Self::PlumbBob(_) => 8.0,
            Self::Equidistant(_) => 0.999 * std::f64::consts::PI,
        };
        let at = |k: usize| most * k as f64 / STEPS as f64;
        let grows = |k: &usize| self.radial(at(*k)) > self.radial(at(k - 1));
        at((1..=STEPS).take_while(grows).last().unwrap_or(0))
    }
}

/// Intrinsics of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    width: u32,
    height: u32,
    focal: [f64; 2],
    centre: [f64; 2],
    distortion: Distortion,
    /// See [`Distortion::growing_limit`].
    limit: f64,
}

/// Largest number of pixels across or down.
const MOST_PIXELS: u32 = 32768;
/// Unprojected pixels return to where they were, to this many pixels.
const ROUND_TRIP: f64 = 1e-3;

impl CameraModel {
    /// A camera with images of `size` (width, height) pixels, focal lengths `fx fy` and principal point `cx cy` in pixels.
    ///
    /// # Errors
    /// [`ColourError::Camera`] for sizes or focal lengths of zero, numbers that are not finite, or a principal point far outside of the image.
    pub fn new(size: [u32; 2], focal: [f64; 2], centre: [f64; 2], distortion: Distortion) -> Result<Self> {
        let fail = |what, value, must| Err(ColourError::Camera { what, value, must });
        for (what, pixels) in ["width", "height"].into_iter().zip(size) {
            if !(2..=MOST_PIXELS).contains(&pixels) {
                return fail(what, f64::from(pixels), "2 to 32768 pixels");
            }
        }
        for (k, what) in ["fx", "fy"].into_iter().enumerate() {
            if !(focal[k].is_finite() && focal[k] > 0.0) {
                return fail(what, focal[k], "above 0: the focal length in pixels, of the calibration of the camera");
            }
        }
        for (k, what) in ["cx", "cy"].into_iter().enumerate() {
            let pixels = f64::from(size[k]);
            if !(-pixels..=2.0 * pixels).contains(&centre[k]) {
                return fail(what, centre[k], "within the image or near it: the principal point in pixels");
            }
        }
        if let Some(bad) = distortion.coefficients().iter().find(|k| !k.is_finite()) {
            return fail("a distortion coefficient", *bad, "finite");
        }
        let limit = distortion.growing_limit();
        Ok(Self { width: size[0], height: size[1], focal, centre, distortion, limit })
    }

    /// Pixels across.
    pub fn width(&self) -> usize {
        self.width as usize
    }

    /// Pixels down.
    pub fn height(&self) -> usize {
        self.height as usize
    }

    /// Focal lengths, pixels.
    pub fn focal(&self) -> [f64; 2] {
        self.focal
    }

    /// Principal point, pixels.
    pub fn centre(&self) -> [f64; 2] {
        self.centre
    }

    /// The lens.
    pub fn distortion(&self) -> Distortion {
        self.distortion
    }

    /// Pixel coordinates of a point in the camera frame, which may lie outside of the image; `None` for what the model does not see: behind the camera, or so
    /// far off the axis that the distortion is not defined.
    pub fn project(&self, p: [f64; 3]) -> Option<[f64; 2]> {
        let normalised = match self.distortion {
            Distortion::PlumbBob(k) => {
                if p[2] <= 1e-6 {
                    return None;
                }
                let (x, y) = (p[0] / p[2], p[1] / p[2]);
                if x * x + y * y >= self.limit * self.limit {
                    return None;
                }
                distort(&k, x, y)
            }
            Distortion::Equidistant(_) => {
                let r = p[0].hypot(p[1]);
                let angle = r.atan2(p[2]);
                if angle >= self.limit {
                    return None;
                }
                let scale = if r > 1e-12 { self.distortion.radial(angle) / r } else { 0.0 };
                [p[0] * scale, p[1] * scale]
            }
        };
        let pixel = std::array::from_fn(|k| self.focal[k] * normalised[k] + self.centre[k]);
        pixel.iter().all(|c: &f64| c.is_finite()).then_some(pixel)
    }

    /// Whether a pixel lies in the image.
    pub fn contains(&self, pixel: [f64; 2]) -> bool {
        let [width, height] = [f64::from(self.width), f64::from(self.height)];
        (-0.5..width - 0.5).contains(&pixel[0]) && (-0.5..height - 0.5).contains(&pixel[1])
    }

    /// Unit vector, camera frame, of the ray that is seen at a pixel; `None` where the model sees nothing.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [u, v]: [f64; 2] = std::array::from_fn(|k| (pixel[k] - self.centre[k]) / self.focal[k]);
        let ray = match self.distortion {
            Distortion::PlumbBob(k) => {
                let [x, y] = undistort(&k, [u, v], self.limit);
                [x, y, 1.0]
            }
            Distortion::Equidistant(_) => {
                let r = u.hypot(v);
                let angle = self.angle_at(r)?;
                let scale = if r > 1e-12 { angle.sin() / r } else { 1.0 };
                [u * scale, v * scale, angle.cos()]
            }
        };
        let back = self.project(ray)?;
        let off = (back[0] - pixel[0]).hypot(back[1] - pixel[1]);
        let length = ray.iter().map(|c| c * c).sum::<f64>().sqrt();
        (off < ROUND_TRIP).then(|| ray.map(|c| c / length))
    }

    /// The angle off the axis that is seen at distance `r` from the centre of a normalised image, by bisection.
    fn angle_at(&self, r: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, self.limit);
        if r > self.distortion.radial(high) {
            return None;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.distortion.radial(middle) < r {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(0.5 * (low + high))
    }
}

/// Brown's distortion of a normalised image.
fn distort(k: &[f64; 8], x: f64, y: f64) -> [f64; 2] {
    let [k1, k2, p1, p2, k3, k4, k5, k6] = k;
    let r2 = x * x + y * y;
    let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
    [x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y]
}

/// Its inverse by Newton's method, inside of `limit`.
fn undistort(k: &[f64; 8], wanted: [f64; 2], limit: f64) -> [f64; 2] {
    const STEP: f64 = 1e-6;
    let [mut x, mut y] = wanted;
    for _ in 0..50 {
        let r = x.hypot(y);
        if r > limit {
            (x, y) = (x * 0.999 * limit / r, y * 0.999 * limit / r);
        }
        let at = distort(k, x, y);
        let (dx, dy) = (distort(k, x + STEP, y), distort(k, x, y + STEP));
        let [a, c] = [(dx[0] - at[0]) / STEP, (dx[1] - at[1]) / STEP];
        let [b, d] = [(dy[0] - at[0]) / STEP, (dy[1] - at[1]) / STEP];
        let determinant = a * d - b * c;
        let [eu, ev] = [wanted[0] - at[0], wanted[1] - at[1]];
        if determinant.abs() < 1e-12 || eu.abs() + ev.abs() < 1e-13 {
            break;
        }
        (x, y) = (x + (d * eu - b * ev) / determinant, y + (a * ev - c * eu) / determinant);
    }
    [x, y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WIDE: Distortion = Distortion::PlumbBob([-0.28, 0.07, 0.0004, -0.0003, 0.0, 0.0, 0.0, 0.0]);
    const FISHEYE: Distortion = Distortion::Equidistant([-0.013, 0.02, -0.012, 0.002]);

    fn camera(distortion: Distortion) -> CameraModel {
        CameraModel::new([752, 480], [458.0, 457.0], [367.0, 248.0], distortion).unwrap()
    }

    proptest! {
        #[test]
        fn each_pixel_is_seen_where_its_ray_comes_from(u in -0.5..751.5f64, v in -0.5..479.5f64, depth in 0.1..50.0f64) {
            for distortion in [Distortion::NONE, WIDE, FISHEYE] {
                let camera = camera(distortion);
                let ray = camera.unproject([u, v]).unwrap();
                let back = camera.project(ray.map(|c| c * depth)).unwrap();
                prop_assert!((back[0] - u).abs() < 1e-3 && (back[1] - v).abs() < 1e-3, "{distortion:?}: {back:?}");
            }
        }
    }

    #[test]
    fn what_is_behind_or_beyond_the_lens_is_not_seen() {
        let pinhole = camera(Distortion::NONE);
        assert_eq!(pinhole.project([0.0, 0.0, 2.0]), Some([367.0, 248.0]));
        assert!(pinhole.project([0.0, 0.0, -2.0]).is_none() && pinhole.project([f64::NAN, 0.0, 1.0]).is_none());
        // The polynomial turns round at a tangent of 1.1 to 1.5: what is farther off the axis would appear in the image again.
        let wide = camera(Distortion::PlumbBob([-0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert!(wide.project([2.0, 0.0, 1.0]).is_none() && wide.project([0.5, 0.0, 1.0]).is_some());
        let fisheye = camera(FISHEYE);
        assert!(fisheye.project([1.0, 0.0, -0.1]).is_some(), "beside and a little behind");
    }

    #[test]
    fn impossible_numbers_are_named() {
        let error = |size, focal, centre| CameraModel::new(size, focal, centre, Distortion::NONE).unwrap_err().to_string();
        assert!(error([640, 480], [0.0, 500.0], [320.0, 240.0]).starts_with("fx is 0, but must be above 0"));
        assert!(error([640, 0], [500.0; 2], [320.0, 240.0]).starts_with("height is 0"));
        assert!(error([640, 480], [500.0; 2], [320.0, 2400.0]).starts_with("cy is 2400"));
        assert!(error([640, 480], [500.0; 2], [f64::NAN, 240.0]).starts_with("cx is NaN"));
        assert!(CameraModel::new([640, 480], [500.0; 2], [320.0, 240.0], Distortion::Equidistant([0.0, f64::NAN, 0.0, 0.0])).is_err());
    }
}
