//! Listing folders.

use crate::{Error, Result};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// The entries of a folder in the order of their names, without hidden ones.
pub(crate) fn list(path: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io(path, "list", e);
    let entries = fs::read_dir(path).map_err(fail)?.map(|e| e.map(|e| e.path()));
    let mut entries = entries.collect::<std::io::Result<Vec<PathBuf>>>().map_err(fail)?;
    entries.retain(|e| !name_of(e).starts_with('.'));
    entries.sort();
    Ok(entries)
}

/// Whether a file has one of the extensions, regardless of case.
pub(crate) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().and_then(OsStr::to_str).is_some_and(|e| extensions.iter().any(|x| e.eq_ignore_ascii_case(x)))
}

/// The last part of a path.
pub(crate) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The name of a file without its extension; `.pcd.bin` is one extension.
pub(crate) fn stem_of(path: &Path) -> String {
    let name = name_of(path);
    match name.to_ascii_lowercase().strip_suffix(".pcd.bin") {
        Some(stem) => name[..stem.len()].to_owned(),
        None => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
    }
}
