//! Whole files: read at once, written atomically.

use crate::{Error, Result};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Reads a regular file. Pipes and devices are refused: they have no size to check claims against.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    let meta = fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    if !meta.is_file() {
        let kind = if meta.is_dir() { "it is a folder" } else { "it is not a regular file" };
        return Err(Error::io(path, "read", io::Error::other(kind)));
    }
    fs::read(path).map_err(|e| Error::io(path, "read", e))
}

/// Writes a file so that it appears under its name complete or not at all: into a temporary neighbour, then renamed.
/// A run that is killed leaves the old file. Missing parent folders are created.
///
/// Protects against dying programs, not against a loss of power: nothing is forced to the disk, which would cost
/// more than the writing when a simulation writes thousands of clouds.
pub(crate) fn write_atomically(path: &Path, body: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let fail = |e| Error::io(path, "write", e);
    let name = path.file_name().ok_or_else(|| fail(io::Error::other("it names no file")))?;
    if let Some(parent) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(parent).map_err(fail)?;
    }
    let mut temporary = OsString::from(".");
    temporary.push(name);
    temporary.push(format!(".{}-{}.tmp", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed)));
    let temporary = path.with_file_name(temporary);

    let written = File::create_new(&temporary).and_then(|file| {
        let mut out = BufWriter::with_capacity(1 << 18, file);
        body(&mut out)?;
        out.flush()?;
        drop(out);
        fs::rename(&temporary, path)
    });
    written.map_err(|e| {
        // The first error is the one to report; a temporary file that cannot be removed is only litter.
        let _ = fs::remove_file(&temporary);
        fail(e)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_litter() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"half of the new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn folders_are_refused_and_parents_made() {
        let dir = tempfile::tempdir().unwrap();
        assert!(read(dir.path()).unwrap_err().to_string().contains("folder"));
        write_atomically(&dir.path().join("new/deep/b.txt"), |w| w.write_all(b"x")).unwrap();
        assert_eq!(read(&dir.path().join("new/deep/b.txt")).unwrap(), b"x");
    }
}
