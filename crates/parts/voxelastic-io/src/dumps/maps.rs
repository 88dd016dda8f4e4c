//! Folders of maps, which would pass for folders of scans.
//!
//! ```text
//! LOAM/
//!   GlobalMap.pcd, CornerMap.pcd, SurfMap.pcd   all scans in the frame of the map
//!   trajectory.pcd, transformations.pcd         positions and poses as points
//! ```
//!
//! LIO-SAM's `mapOptmization.cpp` writes these on its service `save_map`; LeGO-LOAM's has others of the same kind.

use crate::folders::stem_of;
use crate::{Error, Result};
use std::path::Path;

/// Names of clouds that are no scans, in small letters.
const NO_SCANS: [&str; 9] =
    ["globalmap", "cornermap", "surfmap", "finalcloud", "cloudglobal", "cloudcorner", "cloudsurf", "trajectory", "transformations"];

/// Refuses a folder with several clouds of such names.
///
/// # Errors
/// [`Error::Dataset`], which names them.
pub(crate) fn refuse(path: &Path) -> Result<()> {
    let Ok(entries) = std::fs::read_dir(path) else { return Ok(()) };
    let clouds = entries.flatten().map(|entry| entry.path()).filter(|file| file.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcd")));
    let mut found: Vec<String> = clouds.map(|file| stem_of(&file)).filter(|stem| NO_SCANS.contains(&stem.to_ascii_lowercase().as_str())).collect();
    found.sort();
    if found.len() < 2 {
        return Ok(());
    }
    let problem = format!("a map and its poses, not scans: {}", found.iter().map(|stem| format!("{stem}.pcd")).collect::<Vec<_>>().join(", "));
    let remedy = if found.iter().any(|stem| stem == "transformations") {
        "map the recording that it was made of, with `--poses transformations.pcd`"
    } else {
        "map the recording that it was made of"
    };
    Err(Error::dataset(path, problem, remedy))
}
