//! Whole files: read at once, written atomically.

use crate::{Error, Result};
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::Path;

/// Reads a regular file. Pipes and devices are refused: they have no size to check claims against.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    let meta = fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    if !meta.is_file() {
        let kind = if meta.is_dir() { "it is a folder" } else { "it is not a regular file" };
        return Err(Error::io(path, "read", io::Error::other(kind)));
    }
    voxelastic_files::note_read(path);
    voxelastic_files::patiently(|| fs::read(path)).map_err(|e| Error::io(path, "read", e))
}

/// Writes a file so that it appears under its name complete or not at all ([`voxelastic_files::write`]). Missing parent folders are created.
pub(crate) fn write_atomically(path: &Path, body: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let fail = |e| Error::io(path, "write", e);
    if let Some(parent) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(parent).map_err(fail)?;
    }
    voxelastic_files::write(path, body).map_err(fail)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_refused_and_parents_made() {
        let dir = tempfile::tempdir().unwrap();
        assert!(read(dir.path()).unwrap_err().to_string().contains("folder"));
        assert!(write_atomically(dir.path(), |_| Ok(())).unwrap_err().to_string().contains("folder"));
        write_atomically(&dir.path().join("new/deep/b.txt"), |_| Ok(())).unwrap();
        assert!(read(&dir.path().join("new/deep/b.txt")).unwrap().is_empty());
    }
}
