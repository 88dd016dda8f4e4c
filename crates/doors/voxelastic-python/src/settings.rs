//! The settings of the mapper, from their one definition in `voxelastic::settings`.

use crate::errors;
use pyo3::{PyResult, Python, pyfunction};
use std::collections::BTreeMap;
use voxelastic::Settings;
use voxelastic::settings::{Allowed, Group, table};

/// What a setting is: key, Python type (`float`, `int`, `str`, `str | float`, or the allowed words, separated by `|`), default, range with unit, whether it is a basic one, help.
type Row = (&'static str, String, String, String, bool, &'static str);

/// All settings in the order in which they are shown.
#[pyfunction]
pub fn settings_table() -> Vec<Row> {
    let kind = |setting: &voxelastic::settings::Setting| {
        // As text, numbers with a fraction differ from whole ones only where they have one.
        let takes_fractions = ["1.5", "0.5"].iter().any(|number| Settings::default().set(setting.key, number).is_ok());
        let takes_any_text = Settings::default().set(setting.key, "no number").is_ok();
        match (setting.allowed, takes_fractions && !takes_any_text) {
            (Allowed::OneOf(words), _) => words.join("|"),
            (Allowed::Text(_), true) => "str | float".to_owned(),
            (Allowed::Text(_), false) => "str".to_owned(),
            (Allowed::Between(..), true) => "float".to_owned(),
            (Allowed::Between(..), false) => "int".to_owned(),
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
