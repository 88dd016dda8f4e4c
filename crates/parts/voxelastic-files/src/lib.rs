//! Files that are there whole or not at all.
//!
//! [`write()`] fills a temporary file beside its name and renames it when it is complete. A full disk, an error or a killed program leaves the file that
//! was there before. An error removes the temporary at once; what a killed program left is removed when the next file is written in that folder.
//!
//! ```
//! use std::io::Write;
//! # let dir = tempfile::tempdir()?;
//! let path = dir.path().join("path.json");
//! voxelastic_files::write(&path, |out| out.write_all(b"{}"))?;
//! assert_eq!(std::fs::read(&path)?, b"{}");
//! # Ok::<(), std::io::Error>(())
//! ```

#[doc(hidden)]
pub mod failpoint;
mod last_read;
mod patience;
mod scratch;
mod temporaries;

pub use last_read::{last_read, note_read};
pub use patience::patiently;
pub use scratch::Scratch;

/// Whether a lock was refused because the file system has none: some of networks do not, or not without a service that does not run. Nobody else holds it then.
pub fn knows_no_locks(error: &io::Error) -> bool {
    const NO_LOCKS: i32 = if cfg!(any(target_os = "linux", target_os = "android")) { 37 } else { 77 };
    error.kind() == io::ErrorKind::Unsupported || cfg!(unix) && error.raw_os_error() == Some(NO_LOCKS)
}

use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use temporaries::{folder_of, remove_litter_once, temporary_name};

/// Writes the file at `path` through `fill`, so that it appears under its name complete or not at all. The folder must be there. A link
/// stays, and the file that it leads to is replaced. What is no file (`/dev/stdout`, a pipe) is written to as it is.
///
/// Protects against full disks and dying programs, not against a loss of power: nothing is forced to the disk, which would cost
/// more than the writing when a simulation writes thousands of clouds.
///
/// # Errors
/// Those of `fill` and of the file system; the file that was there before is then unchanged.
pub fn write<T>(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> io::Result<T> {
    let path = match fs::metadata(path) {
        Ok(found) if found.is_dir() => return Err(io::Error::other("it is a folder")),
        Ok(found) if !found.is_file() => return fill_up(File::options().write(true).open(path)?, fill).map(|(value, _)| value),
        Ok(_) => fs::canonicalize(path)?,
        Err(_) => path.to_owned(),
    };
    path.file_name().ok_or_else(|| io::Error::other("it names no file"))?;
    remove_litter_once(folder_of(&path));
    failpoint::check("create", &path)?;
    let (temporary, file) = temporary(&path)?;
    let written = fill_up(file, fill).and_then(|(value, file)| {
        failpoint::check("write", &path).inspect_err(|_| drop(file.metadata().and_then(|m| file.set_len(m.len() / 2))))?;
        // Elsewhere an open file cannot be renamed. Here it stays open, and with that locked, until it has its name.
        let _open = cfg!(unix).then_some(file);
        failpoint::check("rename", &path)?;
        fs::rename(&temporary, &path).map(|()| value)
    });
    if written.is_err() {
        // The first error is the one to report; a temporary file that cannot be removed is only litter.
        let _ = failpoint::check("remove", &temporary).and_then(|()| fs::remove_file(&temporary));
    }
    written
}

fn fill_up<T>(file: File, fill: impl FnOnce(&mut BufWriter<File>) -> io::Result<T>) -> io::Result<(T, File)> {
    let mut out = BufWriter::with_capacity(1 << 18, file);
    let value = fill(&mut out)?;
    let file = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    Ok((value, file))
}

/// A new file beside `path`, locked as long as it is open. It is never one that exists, so it cannot be a link that leads elsewhere.
fn temporary(path: &Path) -> io::Result<(PathBuf, File)> {
    loop {
        let temporary = temporary_name(path);
        match patiently(|| File::create_new(&temporary)) {
            // What a killed program left that had our process number.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
            Ok(file) => match file.try_lock() {
                // Before the lock was ours, another process may have taken the file for litter.
                Err(fs::TryLockError::WouldBlock) => {}
                // Some file systems know no locks; litter stays there.
                _ if fs::symlink_metadata(&temporary).is_ok() => return Ok((temporary, file)),
                _ => {}
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_litter() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        write(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write(&path, |w| {
            w.write_all(b"half of the new")?;
            Err::<(), _>(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["a.txt"]);
    }

    #[test]
    fn folders_are_refused_and_not_made() {
        let dir = tempfile::tempdir().unwrap();
        assert!(write(dir.path(), |w| w.write_all(b"x")).unwrap_err().to_string().contains("folder"));
        let missing = write(&dir.path().join("new/b.txt"), |w| w.write_all(b"x")).unwrap_err();
        assert_eq!((missing.kind(), dir.path().join("new").exists()), (io::ErrorKind::NotFound, false));
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_what_is_being_written_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let [dead, alive, foreign] = [".a.ply.1-0.voxelastic.tmp", ".b.ply.1-1.voxelastic.tmp", ".c.tmp"].map(|name| dir.path().join(name));
        [&dead, &alive, &foreign].iter().for_each(|path| fs::write(path, "half").unwrap());
        let open = File::open(&alive).unwrap();
        open.try_lock().unwrap();
        write(&dir.path().join("d.ply"), |w| w.write_all(b"x")).unwrap();
        assert_eq!(names(dir.path()), [".b.ply.1-1.voxelastic.tmp", ".c.tmp", "d.ply"]);
    }

    #[test]
    fn names_may_be_as_long_as_the_file_system_allows() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("n".repeat(255));
        write(&path, |w| w.write_all(b"x")).unwrap();
        assert_eq!(names(dir.path()), ["n".repeat(255)]);
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_stay() {
        let dir = tempfile::tempdir().unwrap();
        let [file, link, device] = ["a.txt", "link.txt", "null"].map(|name| dir.path().join(name));
        write(&file, |w| w.write_all(b"old")).unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        std::os::unix::fs::symlink("/dev/null", &device).unwrap();
        write(&link, |w| w.write_all(b"new")).unwrap();
        write(&device, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!([link, device].iter().all(|path| fs::symlink_metadata(path).unwrap().is_symlink()));
        assert!(File::options().write(true).open("/dev/full").is_err() || write(Path::new("/dev/full"), |w| w.write_all(b"x")).is_err());
    }
}
