//! Finding the metadata file of a capture.

use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// The metadata file of a capture: the only `.json` in its folder, the one of its name, or the one whose name shares the longest prefix with the capture's.
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
    if let Some((_, own)) = found.iter().find(|(_, path)| stem(path) == name) {
        return Ok(own.clone());
    }
    match found.as_slice() {
        [(_, only)] => Ok(only.clone()),
        [(most, best), (second, _), ..] if most > second => Ok(best.clone()),
        _ => Err(Error::dataset(capture, "no metadata of the sensor beside it", "put the sensor's .json there under the same name")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_of_the_captures_name_is_taken_before_longer_names() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for name in ["drive.json", "drive_digest.json", "other.json"] {
            std::fs::write(at(name), "{}").unwrap();
        }
        assert_eq!(find_metadata(&at("drive.pcap")).unwrap(), at("drive.json"));
        assert_eq!(find_metadata(&at("drive_digest_2.pcap")).unwrap(), at("drive_digest.json"));
        assert!(find_metadata(&at("x.pcap")).is_err(), "none is nearer than the others");
    }
}
