//! The settings of the mapper, from their one definition in `voxelastic::settings`.

use crate::errors;
use pyo3::{PyResult, Python, pyfunction};
use std::collections::BTreeMap;
use voxelastic::Settings;
use voxelastic::settings::{Allowed, Group, table};

/// What a setting is: key, Python type (`float`, `int`, `str` or the allowed words, separated by `|`), default, range with unit, whether it is a basic one, help.
type Row = (&'static str, String, String, String, bool, &'static str);

/// All settings in the order in which they are shown.
#[pyfunction]
pub fn settings_table() -> Vec<Row> {
    let kind = |setting: &voxelastic::settings::Setting| match setting.allowed {
        Allowed::OneOf(words) => words.join("|"),
        Allowed::Text(_) => "str".to_owned(),
        // As text, numbers with a fraction differ from whole ones only where they have one.
        Allowed::Between(..) => {
            let takes_fractions = Settings::default().set(setting.key, "1.5").is_ok() || Settings::default().set(setting.key, "0.5").is_ok();
            if takes_fractions { "float" } else { "int" }.to_owned()
        }
    };
    table().iter().map(|s| (s.key, kind(s), s.default.clone(), s.range(), s.group == Group::Basic, s.help)).collect()
}

/// All settings as text: those given, the others with their defaults.
#[pyfunction]
pub fn complete_settings(py: Python<'_>, given: BTreeMap<String, String>) -> PyResult<Vec<(&'static str, String)>> {
    Ok(from_text(py, given)?.pairs())
}

/// Settings from text, checked against each other.
pub fn from_text(py: Python<'_>, given: BTreeMap<String, String>) -> PyResult<Settings> {
    let mut settings = Settings::default();
    for (key, text) in given {
        settings.set(&key, &text).map_err(|e| errors::setting(py, &e))?;
    }
    settings.validate().map_err(|e| errors::setting(py, &e))?;
    Ok(settings)
}
