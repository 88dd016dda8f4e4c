//! Meshes out: PLY for tools, GLB for viewers. ([`crate::ply::read_mesh`] reads PLY back.)

mod glb;
mod glb_textured;
mod glb_tile;
mod mesh_ref;
mod ply;

pub use glb::write_glb;
pub use glb_textured::{EncodedTexture, Texture, write_textured_glb};
pub use glb_tile::{Lattice, tile_glb};
pub use mesh_ref::MeshRef;
pub use ply::write_ply;

use crate::{Error, Result};
use std::path::Path;

/// Formats of meshes, by the endings of their files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// PLY, for tools.
    Ply,
    /// GLB, for viewers.
    Glb,
}

impl Format {
    /// The format that the ending of a name says.
    ///
    /// # Errors
    /// [`Error::Unwritable`] for other endings.
    pub fn of(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        match path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).as_deref() {
            Some("ply") => Ok(Self::Ply),
            Some("glb") => Ok(Self::Glb),
            _ => Err(Error::unwritable(path, "not a known mesh format: use the extension .ply or .glb")),
        }
    }
}

/// Writes a mesh in the [`Format`] that the ending of its name says.
///
/// # Errors
/// [`Error::Unwritable`] for another ending and for a mesh that contradicts itself; those of the system.
pub fn write(path: impl AsRef<Path>, mesh: &MeshRef<'_>) -> Result<()> {
    match Format::of(&path)? {
        Format::Ply => write_ply(path, mesh),
        Format::Glb => write_glb(path, mesh),
    }
}
