//! One writer per map.

use super::files::LOCK;
use crate::{Error, Result};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::Path;
use voxelastic_files::failpoint;

/// Held while a map is written. The operating system releases it when the process ends, however it ends, so a lock is
/// never stale.
#[derive(Debug)]
pub(super) struct Lock {
    file: File,
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Nobody writes any more. So a map that is as it was before is so in every file.
        let _ = self.file.set_len(0);
    }
}

impl Lock {
    /// Locks the map directory `dir`; the file names this process for whoever finds it locked.
    pub fn take(dir: &Path) -> Result<Self> {
        let path = dir.join(LOCK);
        // Where others may write, it could be a link to a file elsewhere, which the note would overwrite.
        if path.symlink_metadata().is_ok_and(|found| !found.is_file()) {
            return Err(Error::damaged(&path, "kind", 0, "it is a link or no regular file, and no map writer made it"));
        }
        let open = || {
            failpoint::check("lock", &path)?;
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path)
        };
        let mut file = open().map_err(Error::on_io("lock", &path))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut pid = String::new();
                let known = (&file).take(20).read_to_string(&mut pid).is_ok() && !pid.trim().is_empty();
                let pid = if known { pid.trim().to_owned() } else { "unknown".to_owned() };
                return Err(Error::Locked { path: dir.to_owned(), pid });
            }
            // Some network file systems know no locks; mapping onto them must still be possible.
            Err(TryLockError::Error(e)) if voxelastic_files::knows_no_locks(&e) => {
                tracing::warn!(path = %path.display(), "the file system knows no locks: make sure that only one process writes this map");
            }
            Err(TryLockError::Error(e)) => return Err(Error::on_io("lock", &path)(e)),
        }
        let note = |file: &mut File| {
            file.set_len(0)?;
            file.write_all(format!("{}\n", std::process::id()).as_bytes())
        };
        // A courtesy, which a full disk may refuse.
        let _ = note(&mut file);
        Ok(Self { file })
    }
}
