//! A saved map in which a node goes on, on request.

use crate::ros::services::NotLoaded;
use std::path::{Path, PathBuf};
use voxelastic::Settings;
use voxelastic_io::Error;
use voxelastic_run::{SavedMap, joining, map_files};

/// A map that was loaded.
pub struct Loaded {
    pub map: SavedMap,
    path: PathBuf,
}

impl Loaded {
    /// Reads a map in which a run with these settings can go on. With `keeps_frame`, poses come in a frame that others know, and are not moved to an origin of the map's own.
    pub fn read(path: &Path, settings: &Settings, keeps_frame: bool) -> Result<Self, (NotLoaded, String)> {
        if !path.is_dir() {
            return Err((NotLoaded::NotThere, format!("{}: there is no such map", path.display())));
        }
        let refused = |why: NotLoaded| move |problem: voxelastic_run::Error| (why_not(&problem).unwrap_or(why), problem.one_line());
        let store = map_files::open(path).map_err(refused(NotLoaded::Damaged))?;
        let of_map = map_files::settings_of(&store).map_err(refused(NotLoaded::Damaged))?;
        joining::check_settings(path, &of_map, settings, "start the node with the settings of the map").map_err(refused(NotLoaded::Differs))?;
        let origin = map_files::origin_of(&store).map_err(refused(NotLoaded::Damaged))?;
        if keeps_frame && !origin.is_zero() {
            let words = format!("{}: its coordinates are counted from {origin} m, and those of the poses that come are not", path.display());
            return Err((NotLoaded::Differs, words));
        }
        let atlas = store.load_atlas().map_err(|error| refused(NotLoaded::Damaged)(map_files::damaged_part(path, error)))?;
        if atlas.scan_count() == 0 {
            return Err((NotLoaded::Differs, format!("{}: the map is empty", path.display())));
        }
        // A log of other scans would say wrong things about these.
        let log = map_files::run_log(&store).filter(|log| log.scans.node.len() == atlas.scan_count());
        Ok(Self { map: SavedMap { atlas, origin, log }, path: path.to_owned() })
    }

    /// What is said about it.
    pub fn words(&self, scans_before: usize) -> String {
        let dropped = if scans_before > 0 { format!("; the map of {scans_before} scans was dropped") } else { String::new() };
        let atlas = &self.map.atlas;
        format!("going on in {}: {} scans, {} submaps{dropped}", self.path.display(), atlas.scan_count(), atlas.submaps().len())
    }
}

/// What an error of reading says by itself.
fn why_not(problem: &voxelastic_run::Error) -> Option<NotLoaded> {
    match problem.file()? {
        Error::NotAMap { .. } => Some(NotLoaded::NotThere),
        Error::Damaged { .. } | Error::Missing { .. } => Some(NotLoaded::Damaged),
        _ => None,
    }
}
