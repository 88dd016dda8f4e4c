//! Folders for what others write in their own way.

use crate::temporaries::{LOCK, folder_of, remove_litter_once, temporary_name};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// A folder beside a file, for code that makes temporaries of its own; removed with all that is in it when this is dropped, and after a kill when the next file is
/// written beside it.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
    lock: Option<File>,
}

impl Scratch {
    /// A new folder beside `path`.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn beside(path: &Path) -> io::Result<Self> {
        remove_litter_once(folder_of(path));
        loop {
            let folder = temporary_name(path);
            match fs::create_dir(&folder) {
                // What a killed program left that had our process number.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
                made => made?,
            }
            match File::create_new(folder.join(LOCK)).and_then(|lock| lock.try_lock().map(|()| lock).map_err(io::Error::from)) {
                Ok(lock) => return Ok(Self { folder, lock: Some(lock) }),
                // Another process takes it for litter, which it was before it was locked.
                Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::WouldBlock) => {}
                // Some file systems know no locks; litter stays there.
                Err(error) if crate::knows_no_locks(&error) => return Ok(Self { folder, lock: None }),
                Err(error) => {
                    let _ = fs::remove_dir_all(&folder);
                    return Err(error);
                }
            }
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What cannot be removed only takes space.
        let _ = fs::remove_dir_all(&self.folder);
        drop(self.lock.take());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_goes_with_its_user_or_after_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.laz");
        let scratch = Scratch::beside(&path).unwrap();
        fs::write(scratch.folder().join("part"), "half").unwrap();
        let dead = dir.path().join(".b.laz.1-0.voxelastic.tmp");
        fs::create_dir(&dead).unwrap();
        ["lock", "part"].iter().for_each(|name| fs::write(dead.join(name), "half").unwrap());
        crate::temporaries::remove_litter(dir.path());
        assert!(!dead.exists() && scratch.folder().join("part").exists());
        let folder = scratch.folder().to_owned();
        drop(scratch);
        assert!(!folder.exists() && fs::read_dir(dir.path()).unwrap().next().is_none());
    }
}
