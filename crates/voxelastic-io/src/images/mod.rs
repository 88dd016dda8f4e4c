//! Images of cameras beside the scans: a folder that `cameras.toml` describes, or topics of a recording.
//!
//! [`open`] finds out what there is. [`Images::iter`] gives one image after the other, not decoded: whoever does not need one does not pay for it.
//!
//! ```toml
//! # cameras.toml, in the folder of the images or above
//! [[camera]]
//! name = "front"
//! images = "front"                      # folder beside this file; names are times: 1700000000.123456.jpg, or in nanoseconds
//! width = 1280
//! height = 720
//! fx = 640.0
//! fy = 640.0
//! cx = 639.5
//! cy = 359.5
//! model = "plumb_bob"                   # or "equidistant"
//! distortion = [-0.1, 0.02, 0.0, 0.0, 0.0]
//! t_lidar_camera = [0.1, 0.0, -0.05, -0.5, 0.5, -0.5, 0.5]
//! ```

mod cameras_file;
mod decode;
mod image_files;
mod raw_pixels;

pub(crate) use cameras_file::{DescribedCamera, distortion};
use decode::{check_size, decode};
pub(crate) use raw_pixels::RawPixels;

use crate::bag::{self, BagImages};
use crate::{Error, Result};
use image_files::ImageFile;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic_colour::{CameraModel, Picture};

/// The name of the file that describes cameras.
pub const CAMERAS_FILE: &str = "cameras.toml";

/// How images are found and read.
#[derive(Clone, Debug, Default)]
pub struct ImageOptions {
    /// The file that describes the cameras; by default `cameras.toml` beside the images. With a recording it says what the recording does not.
    pub cameras: Option<PathBuf>,
    /// Topics of a recording to read images from; empty for all that have intrinsics.
    pub topics: Vec<String>,
    /// The topic of the clouds that the map was made of: the lidar frame is theirs.
    pub cloud_topic: Option<String>,
    /// Pose of the camera in the base frame, for all cameras, instead of what files and recordings say.
    pub t_base_camera: Option<Pose>,
    /// Pose of the lidar in the base frame; if absent, the base is the lidar.
    pub t_base_lidar: Option<Pose>,
}

/// A camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Its name in `cameras.toml`, or its topic.
    pub name: String,
    /// Its intrinsics.
    pub model: CameraModel,
    /// Its pose in the lidar frame: x to the right of the image, y down, z ahead.
    pub t_lidar_camera: Pose,
}

/// Images with their cameras.
#[derive(Debug)]
pub struct Images {
    cameras: Vec<Camera>,
    list: List,
    notes: Vec<String>,
}

#[derive(Debug)]
enum List {
    Files(Vec<ImageFile>),
    Bag(BagImages),
}

/// An image that was found.
#[derive(Debug)]
pub struct Image {
    /// When it was taken, seconds, in the clock of the scans.
    pub time: f64,
    /// Index of its camera in [`Images::cameras`].
    pub camera: usize,
    content: Content,
}

#[derive(Debug)]
pub(crate) enum Content {
    File(PathBuf),
    /// A compressed image in a message, and where it is.
    Compressed {
        bytes: Vec<u8>,
        path: PathBuf,
        at: u64,
    },
    Raw {
        pixels: RawPixels,
        path: PathBuf,
        at: u64,
    },
}

impl Image {
    pub(crate) fn new(time: f64, camera: usize, content: Content) -> Self {
        Self { time, camera, content }
    }

    /// Decodes it.
    ///
    /// # Errors
    /// [`Error::Content`] if it is damaged, cut, of another format, or of another size than `camera` has; [`Error::Io`].
    pub fn decode(&self, camera: &Camera) -> Result<Picture> {
        match &self.content {
            Content::File(path) => decode(&crate::file::read(path)?, path, 0, camera),
            Content::Compressed { bytes, path, at } => decode(bytes, path, *at, camera),
            Content::Raw { pixels, path, at } => pixels.decode(path, *at, camera),
        }
    }
}

/// Opens the images in `path`: a folder with a `cameras.toml`, or a recording.
///
/// # Errors
/// [`Error::Dataset`] if there are no cameras, images, or extrinsics; [`Error::Content`] with the line for impossible intrinsics; [`Error::Io`].
pub fn open(path: impl AsRef<Path>, options: &ImageOptions) -> Result<Images> {
    let path = path.as_ref();
    let beside = path.join(CAMERAS_FILE);
    let file = options.cameras.clone().or_else(|| (path.is_dir() && beside.is_file()).then_some(beside));
    let described = file.as_deref().map(|file| cameras_file::read(file, options)).transpose()?.unwrap_or_default();
    if !described.iter().any(|camera| camera.has_images()) && bag::is_recording(path)? {
        let (cameras, list, notes) = bag::images(path, described, options)?;
        return Ok(Images { cameras, list: List::Bag(list), notes });
    }
    if path.is_file() {
        return Err(Error::dataset(path, "not a recording", "give the folder of the images, or a recording with topics of images"));
    }
    let Some(file) = file else {
        let remedy = "write intrinsics and extrinsics into that file (see the page on colours in the book), or name it with --cameras";
        return Err(Error::dataset(path, format!("no {CAMERAS_FILE} in it, and no recording"), remedy));
    };
    let (mut cameras, mut files) = (Vec::new(), Vec::new());
    for (k, described) in described.into_iter().enumerate() {
        files.extend(image_files::find(path, &file, &described, k)?);
        cameras.push(described.with_extrinsics(&file)?);
    }
    files.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.camera.cmp(&b.camera)));
    Ok(Images { cameras, list: List::Files(files), notes: Vec::new() })
}

impl Images {
    /// The cameras.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// What was decided or left out, in words.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Number of images, if it is known without reading them.
    pub fn len(&self) -> Option<usize> {
        match &self.list {
            List::Files(files) => Some(files.len()),
            List::Bag(_) => None,
        }
    }

    /// Whether it is known that there is no image.
    pub fn is_empty(&self) -> bool {
        self.len() == Some(0)
    }

    /// The images: of a folder in the order of their times, of a recording as they were recorded. An error is about a part that cannot be read.
    pub fn iter(&self) -> Box<dyn Iterator<Item = Result<Image>> + '_> {
        match &self.list {
            List::Files(files) => Box::new(files.iter().map(|file| Ok(Image::new(file.time, file.camera, Content::File(file.path.clone()))))),
            List::Bag(bag) => Box::new(bag.play()),
        }
    }
}
