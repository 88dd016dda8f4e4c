//! The command `voxelastic`, in the process of the interpreter.

use pyo3::{Python, pyfunction};
use std::ffi::OsString;
use std::path::PathBuf;

/// Runs the command and returns its exit code.
#[pyfunction]
pub fn run_command(py: Python<'_>, arguments: Vec<OsString>, program: Option<PathBuf>) -> u8 {
    py.detach(|| voxelastic_cli::run(arguments, program.as_deref()))
}
