//! Where the measuring happens: which program is measured, and the folder that it works in.

use crate::error::{BenchError, Result};
use crate::process;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// The program that is measured and a folder to work in.
#[derive(Debug)]
pub struct Workshop {
    program: PathBuf,
    folder: PathBuf,
}

impl Workshop {
    /// Measures `program`, a `voxelastic` command, in `folder`, which is made if need be.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn open(program: PathBuf, folder: PathBuf) -> Result<Self> {
        let scratch = folder.join("scratch");
        fs::create_dir_all(&scratch).map_err(BenchError::file(&scratch))?;
        Ok(Self { program, folder })
    }

    /// The folder for results and simulated data.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A path for something that is not needed long.
    pub fn scratch(&self, name: &str) -> PathBuf {
        self.folder.join("scratch").join(name)
    }

    /// Removes a file or folder of [`scratch`](Self::scratch), if it is there.
    pub fn discard(&self, name: &str) {
        let path = self.scratch(name);
        // Nothing is lost when scratch stays behind.
        let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
    }

    /// Runs the program with these arguments, quietly; its answer.
    pub(crate) fn ask(&self, arguments: &[String]) -> Result<Value> {
        let arguments: Vec<String> = std::iter::once("-q".to_owned()).chain(arguments.iter().cloned()).collect();
        process::json(&self.program, &arguments)
    }

    /// The command line of [`ask`](Self::ask) as a reader would repeat it.
    pub(crate) fn told(arguments: &[String]) -> String {
        process::line("voxelastic", arguments)
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(self.folder.join("scratch"));
    }
}

/// Words to arguments.
pub(crate) fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

/// The load of the machine: its average over the last minute; none where the system does not tell.
pub(crate) fn load() -> Option<f64> {
    fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}
