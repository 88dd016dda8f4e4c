//! The command `voxelastic`, in the process of the interpreter.

use pyo3::{Python, pyfunction};
use std::ffi::OsString;

/// Runs the command and returns its exit code.
#[pyfunction]
pub fn run_command(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| voxelastic_cli::run(arguments))
}
