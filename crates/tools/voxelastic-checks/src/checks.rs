//! What the sources must satisfy. Each check returns what contradicts [`layers`](crate::layers), with the place and the remedy.

use crate::crate_source::{CrateSource, Reference};
use crate::cycles::cycles;
use crate::layers::{CRATES, EXAMPLE_DEPENDENCIES, KNOWN_ARROWS, KNOWN_CYCLES, KNOWN_UNSAFE_FILES, Layer, ROOMS, UNSAFE_FILES};
use crate::manifest;
use proc_macro2::{TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// A folder with more files than this needs rooms.
const MOST_FILES: usize = 20;

/// The crate whose top modules are rooms.
const CORE: &str = "voxelastic";

/// A folder with `ARCHITECTURE.md` and crates in `crates/`.
#[derive(Clone, Debug)]
pub struct Workspace {
    root: PathBuf,
}

impl Workspace {
    /// The workspace that this crate was built in.
    pub fn this() -> Self {
        Self { root: Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..") }
    }

    /// The folder of a crate, from the root of the workspace.
    fn folder(&self, name: &str) -> String {
        manifest::crates(&self.root).ok().and_then(|mut all| all.remove(name)).unwrap_or_else(|| format!("crates/{name}"))
    }

    fn src(&self, name: &str) -> PathBuf {
        self.root.join(self.folder(name)).join("src")
    }

    /// Folders of sources or tests with so many files that nobody finds one: rooms are missing.
    ///
    /// # Errors
    /// When a folder cannot be read.
    pub fn full_folders(&self) -> Result<Vec<String>, String> {
        let mut files: BTreeMap<PathBuf, usize> = BTreeMap::new();
        for folder in manifest::crates(&self.root)?.values() {
            for part in ["src", "tests"].map(|part| self.root.join(folder).join(part)).iter().filter(|part| part.is_dir()) {
                for file in rust_files(part)? {
                    *files.entry(file.parent().unwrap_or(part).to_owned()).or_default() += 1;
                }
            }
        }
        let full = files.into_iter().filter(|(_, count)| *count > MOST_FILES);
        Ok(full.map(|(folder, count)| format!("{}: {count} files, more than {MOST_FILES}. Make rooms in it.", folder.display())).collect())
    }

    /// The sources of the crate with the rooms.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn core(&self) -> Result<CrateSource, String> {
        CrateSource::read(CORE, &self.src(CORE), "lib.rs")
    }

    /// The sources of all crates: of their libraries and, apart, of their binaries.
    ///
    /// # Errors
    /// When sources cannot be read.
    pub fn sources(&self) -> Result<Vec<CrateSource>, String> {
        let mut sources = Vec::new();
        for name in manifest::crates(&self.root)?.into_keys() {
            for root in ["lib.rs", "main.rs"].into_iter().filter(|root| self.src(&name).join(root).is_file()) {
                sources.push(CrateSource::read(&name, &self.src(&name), root)?);
            }
        }
        Ok(sources)
    }

    /// Dependencies of crates on each other that [`CRATES`] does not have.
    ///
    /// # Errors
    /// When a `Cargo.toml` cannot be read.
    pub fn crate_arrows(&self) -> Result<Vec<String>, String> {
        let mut found = backward_lines("CRATES", CRATES);
        for (name, folder) in manifest::crates(&self.root)? {
            let file = format!("{folder}/Cargo.toml");
            let text = std::fs::read_to_string(self.root.join(&file)).map_err(|e| format!("{file}: {e}"))?;
            let Some(rank) = CRATES.iter().position(|(layer, _)| *layer == name) else {
                found.push(format!(
                    "{file}: the crate is in no layer. Add a line with what it may import to CRATES in layers.rs, and draw it in ARCHITECTURE.md."
                ));
                continue;
            };
            for dependency in manifest::dependencies(&text) {
                let earlier = CRATES[..rank].iter().any(|(layer, _)| *layer == dependency.on);
                let for_examples = EXAMPLE_DEPENDENCIES.contains(&(name.as_str(), dependency.on.as_str()));
                if !(CRATES[rank].1.contains(&dependency.on.as_str()) || dependency.dev && (earlier || for_examples)) {
                    found.push(format!("{file}:{}: {name} -> {} is not in the drawing. {}", dependency.line, dependency.on, REMEDY_ARROW));
                }
            }
        }
        Ok(found)
    }

    /// References between rooms that [`ROOMS`] does not have.
    ///
    /// # Errors
    /// When sources cannot be read.
    pub fn room_arrows(&self) -> Result<Vec<String>, String> {
        let references = self.core()?.room_references();
        let mut found = backward_lines("ROOMS", ROOMS);
        let mut known: BTreeSet<(&str, &str)> = KNOWN_ARROWS.iter().copied().collect();
        for (from, to, reference) in &references {
            let allowed = ROOMS.iter().any(|(room, may)| room == from && may.contains(&to.as_str()));
            if allowed || KNOWN_ARROWS.contains(&(from, to)) {
                known.remove(&(from.as_str(), to.as_str()));
                continue;
            }
            let Reference { from: file, line, path, .. } = reference;
            found.push(format!(
                "{}/src/{file}:{line}: `{path}` makes an arrow {from} -> {to} that is not in the drawing. {REMEDY_ARROW}",
                self.folder(CORE)
            ));
        }
        found.extend(known.iter().map(|(from, to)| format!("KNOWN_ARROWS in layers.rs has {from} -> {to}, which is gone. Remove it from the list.")));
        Ok(found)
    }

    /// Cycles between the files of a crate, beyond those of [`KNOWN_CYCLES`].
    ///
    /// # Errors
    /// When sources cannot be read.
    pub fn file_cycles(&self) -> Result<Vec<String>, String> {
        let mut found = Vec::new();
        for source in self.sources()? {
            let references = source.references();
            let cycles = cycles(&references);
            let files: usize = cycles.iter().map(Vec::len).sum();
            let name = source.name();
            let known = KNOWN_CYCLES.iter().find(|(known, _)| *known == name).map_or(0, |(_, files)| *files);
            if files > known {
                found.extend(cycles.iter().map(|cycle| describe_cycle(name, cycle, &references)));
            } else if files < known {
                found.push(format!("KNOWN_CYCLES in layers.rs allows {known} files of {name} in cycles, and there are {files}. Lower the number."));
            }
        }
        Ok(found)
    }

    /// Files with `unsafe` code that are not in [`UNSAFE_FILES`], and files in the list that `ARCHITECTURE.md` does not name.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn unsafe_files(&self) -> Result<Vec<String>, String> {
        let mut found = Vec::new();
        let mut unused: BTreeSet<(&str, &str)> = UNSAFE_FILES.iter().chain(KNOWN_UNSAFE_FILES).copied().collect();
        for (name, folder) in manifest::crates(&self.root)? {
            let src = self.root.join(&folder).join("src");
            for path in rust_files(&src)? {
                let file = path.strip_prefix(&src).unwrap_or(&path).to_string_lossy().into_owned();
                let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
                let tokens = text.parse().map_err(|e| format!("{folder}/src/{file}: {e}"))?;
                let Some(line) = allows_unsafe(tokens) else { continue };
                let listed = UNSAFE_FILES.iter().chain(KNOWN_UNSAFE_FILES).any(|&(c, f)| c == name && f == file);
                if !listed {
                    found.push(format!(
                        "{folder}/src/{file}:{line}: allows unsafe code. Write it safely, or name the file and the reason in ARCHITECTURE.md and add it to UNSAFE_FILES in layers.rs."
                    ));
                }
                unused.retain(|&(c, f)| (c, f) != (name.as_str(), file.as_str()));
            }
        }
        found.extend(unused.iter().map(|(c, f)| format!("layers.rs lists {c}/src/{f} for unsafe code, which has none. Remove it from the list.")));
        let architecture = self.root.join("ARCHITECTURE.md");
        let text = std::fs::read_to_string(&architecture).map_err(|e| format!("{}: {e}", architecture.display()))?;
        let unnamed = UNSAFE_FILES.iter().filter(|(_, file)| !text.contains(file));
        found.extend(unnamed.map(|(_, f)| format!("ARCHITECTURE.md: does not name {f}, which may hold unsafe code. Name it with the reason.")));
        Ok(found)
    }
}

const REMEDY_ARROW: &str =
    "Move what is needed to the lower of the two, or to a layer below both; where the arrow is right, add it to layers.rs and to the drawing.";

/// Lines that name later lines, by which arrows could go in circles.
fn backward_lines(table: &str, layers: &[Layer]) -> Vec<String> {
    let mut found = Vec::new();
    for (rank, (name, may)) in layers.iter().enumerate() {
        for wrong in may.iter().filter(|m| !layers[..rank].iter().any(|(earlier, _)| earlier == *m)) {
            found.push(format!("{table} in layers.rs: {name} may import {wrong}, which is on no earlier line. Arrows go one way."));
        }
    }
    found
}

/// The files of a cycle, and the arrows between them.
fn describe_cycle(name: &str, cycle: &[String], references: &[Reference]) -> String {
    let mut text = format!(
        "{name}: {} files depend on each other in a cycle. Move what they share to a file of its own, or to the one that is lower:",
        cycle.len()
    );
    for r in references.iter().filter(|r| cycle.contains(&r.from) && cycle.contains(&r.to)) {
        let _ = write!(text, "\n    {name}/src/{}:{}: `{}` -> {}", r.from, r.line, r.path, r.to);
    }
    text
}

/// The line that allows unsafe code, from 1.
fn allows_unsafe(tokens: TokenStream) -> Option<usize> {
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        let found = match (&token, tokens.peek()) {
            (TokenTree::Group(group), _) => allows_unsafe(group.stream()),
            (TokenTree::Ident(word), Some(TokenTree::Group(lints))) if word == "allow" || word == "expect" => {
                let is_unsafe = |lint: TokenTree| matches!(lint, TokenTree::Ident(lint) if lint == "unsafe_code");
                lints.stream().into_iter().any(is_unsafe).then(|| word.span().start().line)
            }
            _ => None,
        };
        if found.is_some() {
            return found;
        }
    }
    None
}

/// All `.rs` files below a folder, sorted.
fn rust_files(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut files = Vec::new();
    for path in entries.flatten().map(|e| e.path()) {
        if path.is_dir() {
            files.extend(rust_files(&path)?);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_name_earlier_layers_only() {
        assert_eq!(backward_lines("T", &[("a", &[]), ("b", &["a"])]), Vec::<String>::new());
        assert!(backward_lines("T", &[("a", &["b"]), ("b", &[])])[0].contains("a may import b"));
    }

    #[test]
    fn allowing_unsafe_code_is_found_with_its_line() {
        let line = |source: &str| allows_unsafe(source.parse().unwrap());
        assert_eq!(line("// allow(unsafe_code)\n#[allow(unsafe_code)]\nfn f() {}"), Some(2));
        assert_eq!(line("fn f() {\n#![cfg_attr(unix, expect(dead_code, unsafe_code))] }"), Some(2));
        assert_eq!(line("#![deny(unsafe_code)] const A: &str = \"allow(unsafe_code)\";"), None);
    }
}
