//! Which files a recording consists of.

use super::format::BagFormat;
use crate::file_names::natural;
use crate::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// Extensions of recordings.
const EXTENSIONS: [&str; 3] = ["bag", "mcap", "db3"];

/// The files of a recording in the order of their names; `None` if `path` is not a recording: neither a file that is one by its first bytes nor
/// a folder that holds files named like some (what `ros2 bag record` makes, or a bag that was split).
///
/// # Errors
/// [`Error::Dataset`] if a folder holds files of several kinds, or compressed ones; [`Error::Io`].
pub(crate) fn find(path: &Path) -> Result<Option<Vec<PathBuf>>> {
    if !path.is_dir() {
        return Ok(BagFormat::of(path)?.map(|_| vec![path.to_owned()]));
    }
    let fail = |e| Error::io(path, "list", e);
    let entries = fs::read_dir(path).map_err(fail)?.map(|e| e.map(|e| e.path()));
    let files: Vec<PathBuf> = entries.collect::<std::io::Result<_>>().map_err(fail)?;
    let named = |file: &Path, extension: &str| file.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension)) && file.is_file();
    let mut kinds: Vec<Vec<PathBuf>> =
        EXTENSIONS.iter().map(|e| files.iter().filter(|f| named(f, e)).cloned().collect()).filter(|f: &Vec<_>| !f.is_empty()).collect();
    if kinds.len() > 1 {
        return Err(Error::dataset(path, "recordings of several kinds", "name one of the files"));
    }
    let Some(mut found) = kinds.pop() else {
        let is_compressed =
            |f: &&PathBuf| (named(f, "zstd") || named(f, "zst")) && f.file_stem().is_some_and(|s| EXTENSIONS.iter().any(|e| named_like(s, e)));
        return match files.iter().find(is_compressed) {
            Some(compressed) => Err(Error::dataset(compressed, "a compressed recording", "unpack it first: zstd -d FILE")),
            None => Ok(None),
        };
    };
    found.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(Some(found))
}

fn named_like(stem: &std::ffi::OsStr, extension: &str) -> bool {
    Path::new(stem).extension().is_some_and(|e| e.eq_ignore_ascii_case(extension))
}
