//! Tiles on the globe: a tree that names the one of a folder and says where on Earth that is. The page of the folder keeps the map frame, in which numbers are small.

use super::tileset::read_root;
use crate::file::write_atomically;
use crate::{Error, Result};
use serde_json::json;
use std::io::Write;
use std::path::Path;
use voxelastic::Pose;

/// Name of the file in the folder of tiles.
pub const EARTH: &str = "earth.json";

/// Writes `earth.json` beside `tileset.json`: 3D Tiles in the frame of the Earth (ECEF), for Cesium and others that show a globe.
///
/// # Errors
/// [`Error::Content`] if there is no tree in the folder; [`Error::Io`].
pub fn write_on_earth(folder: impl AsRef<Path>, t_ecef_map: &Pose) -> Result<()> {
    let folder = folder.as_ref();
    let (bounds, error) = read_root(folder)?;
    // By columns.
    let transform: Vec<f64> = t_ecef_map.to_homogeneous().iter().copied().collect();
    let root = json!({
        "transform": transform,
        "boundingVolume": { "box": bounds },
        "geometricError": error,
        "refine": "REPLACE",
        "content": { "uri": super::tileset::TILESET },
    });
    let text = json!({ "asset": { "version": "1.1", "generator": "Voxelastic" }, "geometricError": error, "root": root }).to_string();
    let path = folder.join(EARTH);
    write_atomically(&path, |out| out.write_all(text.as_bytes()))
}

/// Removes it from the folder of a map that is nowhere.
///
/// # Errors
/// [`Error::Io`].
pub fn remove_from_earth(folder: impl AsRef<Path>) -> Result<()> {
    let path = folder.as_ref().join(EARTH);
    match std::fs::remove_file(&path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(&path, "remove", e)),
        _ => Ok(()),
    }
}
