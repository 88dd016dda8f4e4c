//! Opening images, whatever they are in.

use super::camera::Camera;
use super::cameras_file;
use super::image_files::{self, ImageFile};
use super::options::ImageOptions;
use super::timed_image::{Content, Image};
use crate::bag::{self, BagImages};
use crate::{Error, Result};
use std::path::Path;

/// The name of the file that describes cameras.
pub const CAMERAS_FILE: &str = "cameras.toml";

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
