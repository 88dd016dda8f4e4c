//! Where a receiver was on Earth: from a text file ([`voxelastic_earth::read_text`]), a recording, or `oxts` of a KITTI raw drive.
//!
//! In recordings, fixes are `sensor_msgs/NavSatFix`, `gps_common/GPSFix`, `nmea_msgs/Sentence`, and `nav_msgs/Odometry` of a topic that is named, in metres of a projected
//! system. Their times are those of the message headers.

mod oxts;

use crate::bag;
use crate::{Error, Position, Result, text};
use std::path::Path;
use voxelastic_earth::{EarthError, Fixes};

/// Reads fixes; `topic` names the topic of a recording.
///
/// # Errors
/// [`Error::Content`] with the line, [`Error::Ambiguous`] if a recording has several topics of fixes, [`Error::Dataset`] if it has none; [`Error::Io`].
pub fn read(path: impl AsRef<Path>, topic: Option<&str>) -> Result<Fixes> {
    let path = path.as_ref();
    let is_there = path.metadata().map_err(|e| Error::io(path, "read", e));
    let drives = [path.join("oxts"), path.to_owned()];
    if is_there?.is_dir()
        && let Some(folder) = drives.iter().find(|folder| folder.join("data").is_dir())
    {
        return oxts::read(folder);
    }
    if bag::is_recording(path)? {
        return bag::fixes(path, topic);
    }
    if path.is_dir() {
        return Err(Error::dataset(path, "no fixes in it", "name a file of fixes, a recording, or a KITTI raw drive with oxts"));
    }
    voxelastic_earth::read_text(&text::read(path)?).map_err(|error| of_file(path, &error))
}

/// An error of a file.
pub(crate) fn of_file(path: &Path, error: &EarthError) -> Error {
    match error {
        EarthError::Line { line, problem, remedy } => Error::content(path, Position::line(*line), problem.clone(), *remedy),
        other => Error::content(path, Position::File, other.to_string(), other.remedy()),
    }
}
