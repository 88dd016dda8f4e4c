//! `cameras.toml`: intrinsics and extrinsics.

use super::camera::Camera;
use super::options::ImageOptions;
use crate::{Error, Position, Result, text};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic_colour::{CameraModel, ColourError, Distortion};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CamerasFile {
    camera: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    images: Option<PathBuf>,
    topic: Option<String>,
    times: Option<PathBuf>,
    #[serde(default)]
    time_offset_s: f64,
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    model: Option<String>,
    #[serde(default)]
    distortion: Vec<f64>,
    t_lidar_camera: Option<Vec<f64>>,
    t_base_camera: Option<Vec<f64>>,
    t_base_lidar: Option<Vec<f64>>,
}

/// A camera as the file describes it.
#[derive(Clone, Debug)]
pub(crate) struct DescribedCamera {
    pub(crate) name: String,
    /// Folder of its images, relative to the file.
    pub(crate) images: Option<PathBuf>,
    /// The topic of its images in a recording.
    pub(crate) topic: Option<String>,
    /// File with the times of the images, relative to the file.
    pub(crate) times: Option<PathBuf>,
    /// Added to the times of images, seconds.
    pub(crate) time_offset_s: f64,
    pub(crate) model: CameraModel,
    pub(crate) t_lidar_camera: Option<Pose>,
}

impl DescribedCamera {
    /// Whether its images are files.
    pub(crate) fn has_images(&self) -> bool {
        self.images.is_some()
    }

    /// The camera.
    ///
    /// # Errors
    /// [`Error::Content`] if nothing says where it is.
    pub(crate) fn with_extrinsics(self, file: &Path) -> Result<Camera> {
        let Some(t_lidar_camera) = self.t_lidar_camera else {
            let at = Position::Field(format!("camera {}", self.name));
            let remedy = "give t_lidar_camera (x y z qx qy qz qw) in the file, or --t-base-camera";
            return Err(Error::content(file, at, "nothing says where the camera is", remedy));
        };
        Ok(Camera { name: self.name, model: self.model, t_lidar_camera })
    }
}

/// Reads the file.
///
/// # Errors
/// [`Error::Content`] with the line, or the camera and the number.
pub(super) fn read(path: &Path, options: &ImageOptions) -> Result<Vec<DescribedCamera>> {
    let content = text::read(path)?;
    let line = |offset: usize| content.bytes().take(offset).filter(|b| *b == b'\n').count() + 1;
    let parsed: CamerasFile = toml::from_str(&content).map_err(|error| {
        let at = error.span().map_or(Position::File, |span| Position::line(line(span.start)));
        Error::content(path, at, error.message(), "correct it; the page on colours in the book has an example")
    })?;
    if parsed.camera.is_empty() {
        return Err(Error::content(path, Position::File, "no [[camera]] in it", "describe at least one camera"));
    }
    parsed.camera.into_iter().map(|entry| described(path, entry, options)).collect()
}

fn described(path: &Path, entry: Entry, options: &ImageOptions) -> Result<DescribedCamera> {
    let at = |field: &str| Position::Field(format!("camera {}, {field}", entry.name));
    let distortion = match entry.model.as_deref() {
        None | Some("plumb_bob" | "rational_polynomial" | "radtan") => coefficients(&entry.distortion).map(Distortion::PlumbBob),
        Some("equidistant" | "fisheye") => coefficients(&entry.distortion).map(Distortion::Equidistant),
        Some(other) => {
            let problem = format!("{other:?} is not a known model");
            return Err(Error::content(path, at("model"), problem, "use plumb_bob, rational_polynomial or equidistant"));
        }
    };
    let distortion = distortion.ok_or_else(|| {
        let problem = format!("{} coefficients are too many", entry.distortion.len());
        Error::content(path, at("distortion"), problem, "give k1 k2 p1 p2 k3 (and k4 k5 k6) of plumb_bob, k1 k2 k3 k4 of equidistant")
    })?;
    let model = CameraModel::new([entry.width, entry.height], [entry.fx, entry.fy], [entry.cx, entry.cy], distortion).map_err(|error| {
        let what = match &error {
            ColourError::Camera { what, .. } => what,
            _ => "intrinsics",
        };
        Error::content(path, at(what), error.to_string(), "copy the numbers of the camera's calibration")
    })?;
    if !entry.time_offset_s.is_finite() {
        return Err(Error::content(path, at("time_offset_s"), "it is not finite", "give seconds"));
    }
    let pose = |name: &str, numbers: &Option<Vec<f64>>| -> Result<Option<Pose>> {
        let Some(numbers) = numbers else { return Ok(None) };
        let Ok(numbers) = <[f64; 7]>::try_from(numbers.as_slice()) else {
            return Err(Error::content(path, at(name), format!("{} numbers, not 7", numbers.len()), "give x y z qx qy qz qw"));
        };
        if numbers.iter().any(|n| !n.is_finite()) {
            return Err(Error::content(path, at(name), "a number is not finite", "give x y z qx qy qz qw"));
        }
        let line = text::Line { path, number: 0, text: "" };
        let wrong = |_| Error::content(path, at(name), "its quaternion is not of length 1", "give x y z qx qy qz qw, in this order");
        line.pose(numbers).map(Some).map_err(wrong)
    };
    let (t_lidar_camera, t_base_camera) = (pose("t_lidar_camera", &entry.t_lidar_camera)?, pose("t_base_camera", &entry.t_base_camera)?);
    if t_lidar_camera.is_some() && t_base_camera.is_some() {
        return Err(Error::content(path, at("t_base_camera"), "t_lidar_camera is given, too", "give one of them"));
    }
    let t_base_lidar = options.t_base_lidar.or(pose("t_base_lidar", &entry.t_base_lidar)?).unwrap_or_else(Pose::identity);
    let in_base = options.t_base_camera.or(t_base_camera).map(|t_base_camera| t_base_lidar.inv_mul(&t_base_camera));
    let t_lidar_camera = if options.t_base_camera.is_some() { in_base } else { t_lidar_camera.or(in_base) };
    let Entry { name, images, topic, times, time_offset_s, .. } = entry;
    Ok(DescribedCamera { name, images, topic, times, time_offset_s, model, t_lidar_camera })
}

/// The coefficients, zero where there are fewer; `None` if there are more.
fn coefficients<const N: usize>(given: &[f64]) -> Option<[f64; N]> {
    let mut all = [0.0; N];
    all.get_mut(..given.len())?.copy_from_slice(given);
    Some(all)
}

/// The distortion of a model that a message names.
pub(crate) fn distortion(model: &str, given: &[f64]) -> Option<Distortion> {
    match model {
        // Some drivers leave the model of undistorted images empty.
        "" if given.iter().all(|k| *k == 0.0) => Some(Distortion::NONE),
        "plumb_bob" | "rational_polynomial" | "radtan" => coefficients(given).map(Distortion::PlumbBob),
        "equidistant" | "fisheye" => coefficients(given).map(Distortion::Equidistant),
        _ => None,
    }
}
