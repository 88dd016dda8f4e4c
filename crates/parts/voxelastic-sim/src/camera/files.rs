//! Images in a simulated folder: `images/cameras.toml`, and `images/front/TIME.png`.

use super::lens::t_lidar_camera;
use crate::{SimError, Simulation};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use voxelastic_colour::{CameraModel, Distortion};
use voxelastic_io::images::CAMERAS_FILE;

/// Name of the folder with the images.
const FOLDER: &str = "images";
/// Name of the camera, and of the folder with its images.
pub(crate) const NAME: &str = "front";

impl Simulation {
    /// Image `k` as a PNG.
    pub(crate) fn encoded_image(&self, k: usize) -> Option<Result<Vec<u8>, SimError>> {
        let picture = self.image(k)?;
        let mut png = Vec::new();
        // Compressing hard would take a quarter of the whole simulation.
        let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub);
        let written = encoder.write_image(picture.pixels.as_flattened(), picture.width as u32, picture.height as u32, ExtendedColorType::Rgb8);
        Some(written.map(|()| png).map_err(|e| SimError::Picture(e.to_string())))
    }

    /// Makes the folder and writes what describes the camera, if there is one.
    pub(crate) fn write_camera(&self, dir: &Path) -> Result<(), SimError> {
        let Some(lens) = self.options().camera else { return Ok(()) };
        let folder = dir.join(FOLDER);
        fs::create_dir_all(folder.join(NAME)).map_err(SimError::file(&folder))?;
        let path = folder.join(CAMERAS_FILE);
        let text = description(&lens.model());
        voxelastic_files::write(&path, |out| out.write_all(text.as_bytes())).map_err(SimError::file(&path))
    }

    /// Writes image `k`, if there is a camera.
    pub(crate) fn write_image(&self, dir: &Path, k: usize) -> Result<(), SimError> {
        let (Some(time), Some(png)) = (self.image_time(k), self.encoded_image(k)) else { return Ok(()) };
        let path = dir.join(FOLDER).join(NAME).join(format!("{time:.9}.png"));
        fs::write(&path, png?).map_err(SimError::file(&path))
    }
}

/// `cameras.toml`.
fn description(camera: &CameraModel) -> String {
    let ([fx, fy], [cx, cy]) = (camera.focal(), camera.centre());
    let (model, distortion) = match camera.distortion() {
        Distortion::PlumbBob([k1, k2, p1, p2, k3, ..]) => ("plumb_bob", vec![k1, k2, p1, p2, k3]),
        Distortion::Equidistant(k) => ("equidistant", k.to_vec()),
    };
    let pose = t_lidar_camera();
    let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
    let mut text = format!("[[camera]]\nname = \"{NAME}\"\nimages = \"{NAME}\"\nwidth = {}\nheight = {}\n", camera.width(), camera.height());
    // Writing to a string does not fail.
    let _ = writeln!(text, "fx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\nmodel = \"{model}\"\ndistortion = {distortion:?}");
    let _ = writeln!(text, "t_lidar_camera = {:?}", [t.x, t.y, t.z, q.x, q.y, q.z, q.w]);
    text
}
