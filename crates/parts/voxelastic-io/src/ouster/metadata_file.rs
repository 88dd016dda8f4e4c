//! Finding the metadata file of a capture.

use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// The metadata file of a capture: the only `.json` in its folder, or the one whose name shares the longest prefix with the capture's.
///
/// # Errors
/// [`Error::Dataset`] if there is none, or several share the longest prefix.
pub fn find_metadata(capture: &Path) -> Result<PathBuf> {
    let folder = capture.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = stem(capture);
    let common_prefix = |path: &Path| stem(path).bytes().zip(name.bytes()).take_while(|(a, b)| a == b).count();
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let mut found: Vec<(usize, PathBuf)> = entries
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|x| x.eq_ignore_ascii_case("json")))
        .map(|p| (common_prefix(&p), p))
        .collect();
    found.sort_by(|a, b| b.cmp(a));
    match found.as_slice() {
        [(_, only)] => Ok(only.clone()),
        [(most, best), (second, _), ..] if most > second => Ok(best.clone()),
        _ => Err(Error::dataset(capture, "no metadata of the sensor beside it", "put the sensor's .json there under the same name")),
    }
}
