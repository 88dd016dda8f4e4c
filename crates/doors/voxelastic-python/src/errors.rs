//! Errors as Python exceptions: the classes of `voxelastic._errors`.

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyAnyMethods, PyType};
use pyo3::{Py, PyErr, PyResult, Python};
use std::any::Any;
use voxelastic::settings::SettingError;
use voxelastic_run::error::one_line;

/// A class of `voxelastic._errors`.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A setting is unknown or out of range, or settings contradict each other.
    Setting,
    /// An event was refused; the map is unchanged.
    Refused,
    /// A file cannot be read or written.
    File,
    /// No path was found.
    Plan,
}

static CLASSES: PyOnceLock<[Py<PyType>; 4]> = PyOnceLock::new();

impl Kind {
    /// The exception with `message`.
    pub fn exception(self, py: Python<'_>, message: String) -> PyErr {
        match CLASSES.get_or_try_init(py, || classes(py)) {
            Ok(classes) => PyErr::from_type(classes[self as usize].bind(py).clone(), message),
            Err(error) => error,
        }
    }
}

fn classes(py: Python<'_>) -> PyResult<[Py<PyType>; 4]> {
    let module = py.import("voxelastic._errors")?;
    let class = |name| -> PyResult<Py<PyType>> { Ok(module.getattr(name)?.cast_into::<PyType>()?.unbind()) };
    Ok([class("SettingError")?, class("RefusedError")?, class("FileError")?, class("PlanError")?])
}

/// The exception for a refused setting.
pub fn setting(py: Python<'_>, error: &SettingError) -> PyErr {
    Kind::Setting.exception(py, error.to_string())
}

/// The exception for a file, with its causes: each once.
pub fn file(py: Python<'_>, error: &voxelastic_io::Error) -> PyErr {
    Kind::File.exception(py, one_line(error))
}

/// The exception for something of a run: with its causes, and with what helps, if that is no flag of the command.
pub fn run(py: Python<'_>, error: &voxelastic_run::Error) -> PyErr {
    let text = said(&error.one_line(), error.remedy().unwrap_or_default());
    match error {
        voxelastic_run::Error::Setting(_) => Kind::Setting.exception(py, text),
        _ if error.is_usage() => PyValueError::new_err(text),
        _ => Kind::File.exception(py, text),
    }
}

/// What happened, and what helps, if that is no flag of the command.
pub fn said(text: &str, remedy: &str) -> String {
    let text = text.replace(" (--field)", "");
    if remedy.is_empty() || remedy.contains("--") || remedy.contains("`voxelastic") { text } else { format!("{text}; {remedy}") }
}

/// The exception for a panic: a bug.
pub fn bug(payload: &(dyn Any + Send)) -> PyErr {
    let what = payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str));
    let version = env!("CARGO_PKG_VERSION");
    PyRuntimeError::new_err(format!("voxelastic {version} has a bug: {}; please report it with what led to it", what.unwrap_or("no details")))
}
