//! Decoding JPEG and PNG.

use super::camera::Camera;
use crate::{Error, Position, Result, unpacking};
use image::{ImageFormat, ImageReader, Limits};
use std::io::Cursor;
use std::path::Path;
use voxelastic_colour::Picture;

/// Decodes an image of `camera`, which begins at byte `at` of a file.
///
/// # Errors
/// [`Error::Content`].
pub(crate) fn decode(bytes: &[u8], path: &Path, at: u64, camera: &Camera) -> Result<Picture> {
    let position = || if at == 0 { Position::File } else { Position::Byte(at) };
    let damaged = |problem: String| Error::content(path, position(), problem, "copy or record it again, or leave it out");
    let format = match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Jpeg | ImageFormat::Png)) => format,
        _ => return Err(Error::content(path, position(), "neither JPEG nor PNG", "convert the images to one of the two")),
    };
    // Decoders fill in what a cut JPEG lacks.
    if format == ImageFormat::Jpeg && is_cut(bytes) {
        return Err(damaged(format!("the JPEG is cut: it has {} bytes and no end", bytes.len())));
    }
    let limit = unpacking::limit(bytes.len() as u64);
    let reader = || {
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = Limits::default();
        limits.max_alloc = Some(limit);
        reader.limits(limits);
        reader
    };
    let (width, height) = reader().into_dimensions().map_err(|e| damaged(format!("the image cannot be read: {e}")))?;
    if 3 * u64::from(width) * u64::from(height) > limit {
        return Err(damaged(format!("the image claims {width} x {height} pixels in {} bytes", bytes.len())));
    }
    check_size([width as usize, height as usize], path, at, camera)?;
    let image = reader().decode().map_err(|e| damaged(format!("the image cannot be decoded: {e}")))?.into_rgb8();
    let pixels = image.as_raw().as_chunks::<3>().0.to_vec();
    Ok(Picture { width: width as usize, height: height as usize, pixels })
}

/// Refuses an image of another size than those of the camera.
pub(crate) fn check_size([width, height]: [usize; 2], path: &Path, at: u64, camera: &Camera) -> Result<()> {
    let (model, name) = (&camera.model, &camera.name);
    if [width, height] == [model.width(), model.height()] {
        return Ok(());
    }
    let position = if at == 0 { Position::File } else { Position::Byte(at) };
    let problem =
        format!("the image has {width} x {height} pixels, but the intrinsics of camera {name} are for {} x {}", model.width(), model.height());
    Err(Error::content(path, position, problem, "give the intrinsics of these images: fx, fy, cx and cy scale with the size"))
}

/// Whether a JPEG has no marker of its end after the last beginning of data. A thumbnail has an end of its own, but comes before.
fn is_cut(bytes: &[u8]) -> bool {
    let last = |marker: u8| bytes.windows(2).rposition(|w| w == [0xff, marker]);
    last(0xd9) <= last(0xda)
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;
    use voxelastic_colour::{CameraModel, Distortion};

    fn camera() -> Camera {
        let model = CameraModel::new([24, 16], [20.0; 2], [11.5, 7.5], Distortion::NONE).unwrap();
        Camera { name: "front".to_owned(), model, t_lidar_camera: Pose::identity() }
    }

    fn encoded(format: ImageFormat) -> Vec<u8> {
        let image = image::RgbImage::from_fn(24, 16, |x, y| image::Rgb([10 * x as u8, 15 * y as u8, 77]));
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    fn decoded(bytes: &[u8]) -> Result<Picture> {
        decode(bytes, Path::new("front/1.5.jpg"), 0, &camera())
    }

    #[test]
    fn pictures_are_as_they_were_encoded() {
        assert_eq!(decoded(&encoded(ImageFormat::Png)).unwrap().pixels[24 * 3 + 5], [50, 45, 77]);
        let jpeg = decoded(&encoded(ImageFormat::Jpeg)).unwrap().pixels[24 * 3 + 5];
        assert!((0..3).all(|k| jpeg[k].abs_diff([50, 45, 77][k]) < 20), "{jpeg:?}");
    }

    #[test]
    fn images_larger_than_their_files_can_hold_are_refused() {
        let mut png = encoded(ImageFormat::Png);
        // Width and height are the first numbers of the first chunk; then comes its checksum, after five bytes.
        png[16..24].copy_from_slice(&[0, 0, 0x20, 0, 0, 0, 0x20, 0]);
        let crc = crc32fast::hash(&png[12..29]).to_be_bytes();
        png[29..33].copy_from_slice(&crc);
        let error = decoded(&png).unwrap_err().to_string();
        assert!(error.contains("8192 x 8192 pixels in"), "{error}");
    }

    #[test]
    fn cut_and_damaged_images_are_errors_or_pictures_and_no_panic() {
        let jpeg = encoded(ImageFormat::Jpeg);
        for length in [jpeg.len() / 3, jpeg.len() - 40, jpeg.len() - 2] {
            let error = decoded(&jpeg[..length]).unwrap_err().to_string();
            assert!(error.starts_with("front/1.5.jpg: ") && error.contains("copy or record it again"), "{error}");
        }
        assert!(decoded(&jpeg[..jpeg.len() - 40]).unwrap_err().to_string().contains("the JPEG is cut"));
        for format in [ImageFormat::Png, ImageFormat::Jpeg] {
            let good = encoded(format);
            for k in 0..400 {
                let mut bad = good.clone();
                let at = k * 7919 % bad.len();
                bad[at] = bad[at].wrapping_add(1 + (k % 250) as u8);
                if let Ok(picture) = decoded(&bad) {
                    assert_eq!(picture.pixels.len(), 24 * 16);
                }
                let _ = decoded(&good[..k * 31 % good.len()]);
            }
        }
    }
}
