//! Recordings written by other people's software (`write.py`: rosbags, mcap). The fixtures are some of what it wrote; the rest is written
//! anew where Python has the packages (`VOXELASTIC_PYTHON`, default `python3`).

#[path = "../common/damage.rs"]
mod damage;
mod drive;
mod harm;
mod written;

use std::path::{Path, PathBuf};
use std::process::Command;

/// A recording in the repository.
fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bags/fixtures").join(name)
}

/// Runs a script; `false`, with a word, if Python cannot import the modules.
fn python(modules: &str, script: &str, arguments: &[&Path]) -> bool {
    let interpreter = std::env::var("VOXELASTIC_PYTHON").unwrap_or_else(|_| "python3".into());
    let probe = Command::new(&interpreter).args(["-c", &format!("import {modules}")]).output();
    if !probe.is_ok_and(|p| p.status.success()) {
        eprintln!("skipped: {interpreter} cannot import {modules} (set VOXELASTIC_PYTHON to an interpreter that can)");
        return false;
    }
    let output = Command::new(&interpreter).args(["-c", script]).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    true
}
