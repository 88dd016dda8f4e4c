//! The program under test and the folder for its data.

use crate::error::{BenchError, Result};
use crate::process;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

/// The program under test and a working folder.
#[derive(Debug)]
pub struct Workspace {
    program: PathBuf,
    folder: PathBuf,
}

impl Workspace {
    /// A workspace for `program`, a `voxelastic` command, in `folder`, which is created if it does not exist.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn create(program: PathBuf, folder: PathBuf) -> Result<Self> {
        let scratch = folder.join("scratch");
        fs::create_dir_all(&scratch).map_err(BenchError::file(&scratch))?;
        Ok(Self { program, folder })
    }

    /// The folder for results and simulated data.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A path for temporary data.
    pub fn scratch(&self, name: &str) -> PathBuf {
        self.folder.join("scratch").join(name)
    }

    /// Removes a file or folder of [`scratch`](Self::scratch), if it exists.
    pub fn remove_scratch(&self, name: &str) {
        let path = self.scratch(name);
        // Scratch that cannot be removed does no harm.
        let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
    }

    /// Runs the program with these arguments and `-q`, and returns the JSON object that it prints.
    pub(crate) fn run_json(&self, arguments: &[String]) -> Result<Value> {
        let arguments: Vec<String> = std::iter::once("-q".to_owned()).chain(arguments.iter().cloned()).collect();
        process::run_json(&self.program, &arguments)
    }

    /// What the program says of its version: commit, features and instructions, in one line.
    pub(crate) fn version(&self) -> Result<String> {
        process::output(&self.program, &words(&["--version"])).map(|said| said.trim().replace('\n', "; "))
    }

    /// The command line of [`run_json`](Self::run_json) as one would type it.
    pub(crate) fn command_line(arguments: &[String]) -> String {
        process::command_line("voxelastic", arguments)
    }
}

impl Drop for Workspace {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(self.folder.join("scratch"));
    }
}

/// Arguments from string slices.
pub(crate) fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

/// Load average of the last minute; none where the system does not report it.
pub(crate) fn load() -> Option<f64> {
    fs::read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}
