//! An image that is not decoded.

use super::camera::Camera;
use super::decode::decode;
use super::raw_pixels::RawPixels;
use crate::Result;
use std::path::PathBuf;
use voxelastic_colour::Picture;

/// An image that was found.
#[derive(Debug)]
pub struct Image {
    /// When it was taken, seconds, in the clock of the scans.
    pub time: f64,
    /// Index of its camera in [`Images::cameras`](crate::images::Images::cameras).
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
    /// [`Error::Content`](crate::Error::Content) if it is damaged, cut, of another format, or of another size than `camera` has; [`Error::Io`](crate::Error::Io).
    pub fn decode(&self, camera: &Camera) -> Result<Picture> {
        match &self.content {
            Content::File(path) => decode(&crate::file::read(path)?, path, 0, camera),
            Content::Compressed { bytes, path, at } => decode(bytes, path, *at, camera),
            Content::Raw { pixels, path, at } => pixels.decode(path, *at, camera),
        }
    }
}
