//! A disk that is soon full.

use crate::skip::{Need, skip};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A file system of a fixed size, unmounted when this is dropped.
#[derive(Debug)]
pub struct SmallDisk {
    folder: PathBuf,
}

impl SmallDisk {
    /// Mounts a file system of `bytes` at `folder`, which is made; none, after noting the skip, where the user may not mount.
    pub fn mount(folder: &Path, bytes: usize) -> Option<Self> {
        std::fs::create_dir_all(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
        let mounted = mount(&["-t", "tmpfs", "-o", &format!("size={bytes}"), "tmpfs"], folder);
        if !mounted {
            skip(Need::System, "only root can mount a small disk");
        }
        mounted.then(|| Self { folder: folder.to_owned() })
    }

    /// The folder that it is mounted at.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Takes all space that is left with a file, and returns its path.
    ///
    /// # Panics
    /// When the disk cannot be written at all.
    pub fn fill(&self) -> PathBuf {
        let ballast = self.folder.join("ballast");
        let mut file = std::fs::File::create(&ballast).unwrap_or_else(|e| panic!("{}: {e}", ballast.display()));
        while std::io::Write::write_all(&mut file, &[0; 4096]).is_ok() {}
        ballast
    }

    /// Lets nothing be written any more.
    ///
    /// # Panics
    /// When the system refuses.
    pub fn make_read_only(&self) {
        assert!(mount(&["-o", "remount,ro"], &self.folder), "cannot make {} read-only", self.folder.display());
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // Lazily: a process of a test that failed may still use it.
        let _ = Command::new("umount").arg("-l").arg(&self.folder).output();
    }
}

fn mount(arguments: &[&str], folder: &Path) -> bool {
    Command::new("mount").args(arguments).arg(folder).output().is_ok_and(|done| done.status.success())
}
