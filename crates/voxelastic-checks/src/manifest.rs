//! Dependencies between the crates of this workspace, from their `Cargo.toml` files.

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

/// The folders in `crates/`, which have the names of their crates, sorted.
///
/// # Errors
/// When the folder cannot be read.
pub fn crates(workspace: &Path) -> Result<Vec<String>, String> {
    let folder = workspace.join("crates");
    let entries = std::fs::read_dir(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let is_crate = |e: &std::fs::DirEntry| e.path().join("Cargo.toml").is_file();
    let mut names: Vec<String> = entries.flatten().filter(is_crate).map(|e| e.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
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
