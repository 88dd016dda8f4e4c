//! Dependencies between the crates of this workspace, from their `Cargo.toml` files.

use std::collections::BTreeMap;
use std::path::Path;

/// A dependency on another crate of the workspace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dependency {
    /// The crate that is depended on.
    pub on: String,
    /// Line in the `Cargo.toml`, from 1.
    pub line: usize,
    /// Whether only tests, benches and examples have it.
    pub dev: bool,
}

/// The folders of the crates, `TIER/NAME` in `crates/`, by the names of the crates.
///
/// # Errors
/// When a folder cannot be read.
pub fn crates(workspace: &Path) -> Result<BTreeMap<String, String>, String> {
    let mut found = BTreeMap::new();
    for tier in folders(&workspace.join("crates"))? {
        for name in folders(&workspace.join("crates").join(&tier))? {
            found.insert(name.clone(), format!("crates/{tier}/{name}"));
        }
    }
    Ok(found)
}

fn folders(of: &Path) -> Result<Vec<String>, String> {
    let entries = std::fs::read_dir(of).map_err(|e| format!("{}: {e}", of.display()))?;
    Ok(entries.flatten().filter(|e| e.path().is_dir()).map(|e| e.file_name().to_string_lossy().into_owned()).collect())
}

/// The dependencies on crates of the workspace (those whose names start with `voxelastic`) that a `Cargo.toml` declares.
pub fn dependencies(text: &str) -> Vec<Dependency> {
    let mut found = Vec::new();
    let mut section = "";
    for (line, text) in (1..).zip(text.lines().map(str::trim)) {
        if let Some(name) = text.strip_prefix('[').and_then(|t| t.strip_suffix(']')) {
            section = name;
        } else if section.ends_with("dependencies") && text.starts_with("voxelastic") {
            let on = text.split(['.', '=', ' ']).next().unwrap_or(text).to_owned();
            found.push(Dependency { on, line, dev: section.ends_with("dev-dependencies") });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dependencies_of_the_workspace_are_found() {
        let text = "[package]\nname = \"voxelastic-a\"\n[dependencies]\nvoxelastic.workspace = true\nserde = \"1\"\n[dev-dependencies]\nvoxelastic-b = { path = \"../b\" }\n";
        let expected = [("voxelastic", 4, false), ("voxelastic-b", 7, true)];
        assert_eq!(dependencies(text), expected.map(|(on, line, dev)| Dependency { on: on.into(), line, dev }));
    }
}
