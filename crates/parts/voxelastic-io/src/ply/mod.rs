//! PLY files: clouds, and triangle meshes read back. Text and binary, either byte order.

mod header;
mod mesh;
mod vertices;

pub use mesh::{MeshData, parse_mesh, read_mesh};

use crate::{Result, StampedCloud, file};
use std::path::Path;

/// Reads the vertices of a PLY file as an unorganised cloud.
///
/// Coordinates may be f32 or f64. Return strength, ring and time are taken under the same names as in PCD files
/// (and as CloudCompare's `scalar_*`); other properties and elements are skipped.
///
/// # Errors
/// [`crate::Error::Content`] if the file breaks the format, is shorter than its header claims or lacks x, y or z;
/// [`crate::Error::NoReturn`]; [`crate::Error::Io`].
pub fn read_cloud(path: impl AsRef<Path>) -> Result<StampedCloud> {
    parse_cloud(&file::read(path.as_ref())?, path.as_ref())
}

/// Decodes the vertices of a PLY file from its bytes; `path` is for messages only.
///
/// # Errors
/// As [`read_cloud`], without [`crate::Error::Io`].
pub fn parse_cloud(bytes: &[u8], path: &Path) -> Result<StampedCloud> {
    let header = header::parse(bytes, path)?;
    vertices::cloud(bytes, &header, path)
}
