//! Files with the angles of a sensor's beams, beside its captures.

use crate::{Error, Position, Result, file};
use std::path::{Path, PathBuf};

/// Elevation and azimuth of each beam, degrees.
pub(super) type BeamAngles = Vec<[f64; 2]>;

/// The file with angles beside a capture: of those that hold some, the one whose name shares the longest prefix with the capture's; none if two share as much.
pub(crate) fn find_angles(capture: &Path) -> Option<PathBuf> {
    let folder = capture.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = stem(capture);
    let common = |path: &Path| stem(path).bytes().zip(name.bytes()).take_while(|(a, b)| a == b).count();
    let all = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let tables = all.filter(|path| path.extension().is_some_and(|x| x.eq_ignore_ascii_case("csv")) && path.is_file() && read_angles(path).is_ok());
    let mut found: Vec<(usize, PathBuf)> = tables.map(|path| (common(&path), path)).collect();
    found.sort_by(|a, b| b.cmp(a));
    match found.as_slice() {
        [(_, only)] => Some(only.clone()),
        [(most, best), (second, _), ..] if most > second => Some(best.clone()),
        _ => None,
    }
}

/// Reads a table of angles as Hesai's sensors give it: a line for each channel with its number, its elevation and its azimuth, degrees, under a heading.
///
/// # Errors
/// [`Error::Content`] if it is none; [`Error::Io`].
pub(super) fn read_angles(path: &Path) -> Result<BeamAngles> {
    let bytes = file::read(path)?;
    let text = String::from_utf8_lossy(&bytes);
    let bad = |line: usize, problem: &str| {
        let remedy = "give the sensor's angle correction: a heading Channel,Elevation,Azimuth, and a line for each channel";
        Error::content(path, Position::line(line), problem.to_owned(), remedy)
    };
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    let words = |line: &str| line.split(',').map(|word| word.trim().to_ascii_lowercase()).collect::<Vec<_>>();
    let heading = lines.next().map(|(_, line)| words(line)).unwrap_or_default();
    let column = |name: &str| heading.iter().position(|word| word.contains(name));
    let (Some(elevation), Some(azimuth)) = (column("elevation"), column("azimuth")) else {
        return Err(bad(1, "no columns of elevation and azimuth"));
    };
    let mut angles = BeamAngles::new();
    for (number, line) in lines {
        let words = words(line);
        let angle = |at: usize| words.get(at).and_then(|word| word.parse().ok()).filter(|v: &f64| v.abs() <= 360.0);
        let (Some(elevation), Some(azimuth)) = (angle(elevation), angle(azimuth)) else { return Err(bad(number, "not two angles in degrees")) };
        if elevation.abs() > 90.0 || angles.len() >= 256 {
            return Err(bad(number, "an elevation beyond the zenith, or more than 256 channels"));
        }
        angles.push([elevation, azimuth]);
    }
    if angles.is_empty() { Err(bad(1, "no channels")) } else { Ok(angles) }
}
