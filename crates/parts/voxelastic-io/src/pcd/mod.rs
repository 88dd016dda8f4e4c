//! Point clouds in the PCD format of the Point Cloud Library: text, binary and compressed; any fields in any order.

mod body;
mod header;
mod lzf;
mod write;

pub use write::{write, write_with_normals};

use crate::{Result, StampedCloud, file};
use std::path::Path;

/// Reads a PCD cloud.
///
/// Coordinates may be f32 or f64. Return strength, ring and time are taken under the names that Ouster, Velodyne, Livox,
/// Hesai and RoboSense drivers and FAST-LIO give them; other fields are skipped. `VIEWPOINT` is not applied: scans are
/// in the lidar frame.
///
/// # Errors
/// [`crate::Error::Content`] if the file breaks the format, is shorter than its header claims or lacks x, y or z;
/// [`crate::Error::NoReturn`]; [`crate::Error::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<StampedCloud> {
    parse(&file::read(path.as_ref())?, path.as_ref())
}

/// Numbers of the fields of these names, one list each, out of a binary PCD file that may hold anything; `path` is for messages only.
///
/// # Errors
/// [`crate::Error::Content`] if the file breaks the format, is not binary, or lacks a field.
pub(crate) fn columns(bytes: &[u8], path: &Path, names: &[&str]) -> Result<Vec<Vec<f64>>> {
    let header = header::parse(bytes, path)?;
    names.iter().map(|name| body::column(bytes, &header, name, path)).collect()
}

/// Decodes a PCD cloud from the bytes of a file; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`crate::Error::Io`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<StampedCloud> {
    let header = header::parse(bytes, path)?;
    body::parse(bytes, &header, path)
}
