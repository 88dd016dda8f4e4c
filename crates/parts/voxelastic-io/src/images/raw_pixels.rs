//! Pixels as `sensor_msgs/Image` has them.

use super::camera::Camera;
use super::decode::check_size;
use crate::{Error, Position, Result};
use std::path::Path;
use voxelastic_colour::Picture;

/// Pixels that are not decoded.
#[derive(Debug)]
pub(crate) struct RawPixels {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Such as `rgb8`, of the header `sensor_msgs/image_encodings.h`.
    pub(crate) encoding: String,
    /// Bytes of a row.
    pub(crate) step: usize,
    pub(crate) bytes: Vec<u8>,
}

/// How the bytes of a pixel are laid out.
#[derive(Clone, Copy)]
enum Layout {
    /// Bytes of a pixel, and where its red, green and blue are.
    Channels(usize, [usize; 3]),
    /// Colour filters before the pixels: whether red is in odd columns, and in odd rows.
    Bayer { red: [usize; 2] },
}

impl Layout {
    fn of(encoding: &str) -> Option<Self> {
        Some(match encoding {
            "rgb8" => Self::Channels(3, [0, 1, 2]),
            "bgr8" | "8UC3" => Self::Channels(3, [2, 1, 0]),
            "rgba8" => Self::Channels(4, [0, 1, 2]),
            "bgra8" | "8UC4" => Self::Channels(4, [2, 1, 0]),
            "mono8" | "8UC1" => Self::Channels(1, [0, 0, 0]),
            "bayer_rggb8" => Self::Bayer { red: [0, 0] },
            "bayer_bggr8" => Self::Bayer { red: [1, 1] },
            "bayer_gbrg8" => Self::Bayer { red: [0, 1] },
            "bayer_grbg8" => Self::Bayer { red: [1, 0] },
            _ => return None,
        })
    }
}

impl RawPixels {
    /// Whether images of this encoding can be read: depth and 16 bits cannot.
    pub(crate) fn is_known(&self) -> bool {
        Layout::of(&self.encoding).is_some()
    }

    /// Decodes the message at byte `at` of a recording.
    ///
    /// # Errors
    /// [`Error::Content`] if it is of an unknown encoding, too short, or of another size than `camera` has.
    pub(crate) fn decode(&self, path: &Path, at: u64, camera: &Camera) -> Result<Picture> {
        let (width, height) = (self.width, self.height);
        let error = |problem: String, remedy: &'static str| Error::content(path, Position::Byte(at), problem, remedy);
        let layout = Layout::of(&self.encoding).ok_or_else(|| {
            let remedy = "record rgb8, bgr8, rgba8, bgra8, mono8 or 8 bit Bayer images, or compressed ones";
            error(format!("images of encoding {:?} are not read", self.encoding), remedy)
        })?;
        check_size([width, height], path, at, camera)?;
        let bytes_of_pixel = if let Layout::Channels(bytes, _) = layout { bytes } else { 1 };
        if self.step < width * bytes_of_pixel || self.bytes.len() < self.step.saturating_mul(height) {
            let problem = format!("the image is cut: {} bytes for {height} rows of {} bytes", self.bytes.len(), self.step);
            return Err(error(problem, "record it again, or leave it out"));
        }
        let pixel = |x: usize, y: usize| match layout {
            Layout::Channels(bytes, order) => order.map(|k| self.bytes[y * self.step + x * bytes + k]),
            Layout::Bayer { red } => self.behind_filters(x, y, red),
        };
        Ok(Picture { width, height, pixels: (0..width * height).map(|i| pixel(i % width, i / width)).collect() })
    }

    /// Means of the same colour among a pixel and its eight neighbours.
    fn behind_filters(&self, x: usize, y: usize, red: [usize; 2]) -> [u8; 3] {
        let (mut sums, mut counts) = ([0u32; 3], [0u32; 3]);
        for v in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
            for u in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                let colour = match (u % 2 == red[0], v % 2 == red[1]) {
                    (true, true) => 0,
                    (false, false) => 2,
                    _ => 1,
                };
                sums[colour] += u32::from(self.bytes[v * self.step + u]);
                counts[colour] += 1;
            }
        }
        std::array::from_fn(|k| (sums[k] / counts[k].max(1)) as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;
    use voxelastic_colour::{CameraModel, Distortion};

    fn camera() -> Camera {
        let model = CameraModel::new([6, 4], [5.0; 2], [2.5, 1.5], Distortion::NONE).unwrap();
        Camera { name: "front".to_owned(), model, t_lidar_camera: Pose::identity() }
    }

    fn image(encoding: &str, bytes_of_pixel: usize, value: impl Fn(usize, usize, usize) -> u8) -> RawPixels {
        // Rows have two bytes more than they need.
        let step = 6 * bytes_of_pixel + 2;
        let mut bytes = vec![99; step * 4];
        for (y, x, k) in (0..4).flat_map(|y| (0..6).flat_map(move |x| (0..bytes_of_pixel).map(move |k| (y, x, k)))) {
            bytes[y * step + x * bytes_of_pixel + k] = value(x, y, k);
        }
        RawPixels { width: 6, height: 4, encoding: encoding.to_owned(), step, bytes }
    }

    #[test]
    fn channels_are_ordered() {
        let decoded =
            |encoding: &str, bytes| image(encoding, bytes, |x, y, k| (100 * k + 10 * y + x) as u8).decode(Path::new("a.bag"), 7, &camera()).unwrap();
        assert_eq!(decoded("rgb8", 3).pixels[6 * 2 + 3], [23, 123, 223]);
        assert_eq!(decoded("bgra8", 4).pixels[6 * 2 + 3], [223, 123, 23]);
        assert_eq!(decoded("mono8", 1).pixels[6 * 2 + 3], [23, 23, 23]);
    }

    #[test]
    fn colours_are_found_behind_filters() {
        for (encoding, pattern) in [
            ("bayer_rggb8", [[0, 1], [1, 2]]),
            ("bayer_bggr8", [[2, 1], [1, 0]]),
            ("bayer_gbrg8", [[1, 2], [0, 1]]),
            ("bayer_grbg8", [[1, 0], [2, 1]]),
        ] {
            let behind = image(encoding, 1, |x, y, _| [200, 100, 50][pattern[y % 2][x % 2]]);
            assert!(behind.decode(Path::new("a.bag"), 7, &camera()).unwrap().pixels.iter().all(|p| *p == [200, 100, 50]), "{encoding}");
        }
    }

    #[test]
    fn what_is_wrong_is_said() {
        let error = |image: RawPixels| image.decode(Path::new("a.bag"), 7, &camera()).unwrap_err().to_string();
        assert!(error(image("16UC1", 2, |_, _, _| 0)).contains("a.bag, byte 7: images of encoding \"16UC1\" are not read; record rgb8"));
        assert!(
            error(RawPixels { bytes: vec![0; 30], ..image("rgb8", 3, |_, _, _| 0) }).contains("the image is cut: 30 bytes for 4 rows of 20 bytes")
        );
        let other = error(RawPixels { width: 3, ..image("rgb8", 3, |_, _, _| 0) });
        assert!(other.contains("the image has 3 x 4 pixels, but the intrinsics of camera front are for 6 x 4; give the intrinsics"), "{other}");
    }
}
