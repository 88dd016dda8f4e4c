//! A crate's modules, and which of its files refer to which.

use crate::module::{Import, Module, Path, parse};
use std::collections::BTreeMap;
use std::path::Path as FilePath;

/// The modules of a crate by their paths, with the files that they are in.
#[derive(Debug, Default)]
pub struct CrateSource {
    name: String,
    modules: BTreeMap<Vec<String>, (String, Module)>,
}

/// A reference from one file of a crate to another.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Reference {
    /// The file that refers, relative to the crate's `src`.
    pub from: String,
    /// The file that defines what is referred to.
    pub to: String,
    /// Line in `from`.
    pub line: usize,
    /// The path as written.
    pub path: String,
}

/// Follows at most so many re-exports.
const RE_EXPORTS: usize = 8;

impl CrateSource {
    /// Reads the sources of a crate, starting with `root` (`lib.rs` or `main.rs`) in the folder `src`.
    ///
    /// # Errors
    /// When a file cannot be read or is not Rust, or a module is declared that has no file.
    pub fn read(name: &str, src: &FilePath, root: &str) -> Result<Self, String> {
        let mut source = Self { name: name.to_owned(), modules: BTreeMap::new() };
        source.read_module(&|file| std::fs::read_to_string(src.join(file)).ok(), root.to_owned(), Vec::new())?;
        Ok(source)
    }

    /// The same of files in memory, the first of which is the root.
    ///
    /// # Panics
    /// When a file is not Rust, or a module is declared that has no file.
    pub fn from_files(name: &str, files: &[(&str, &str)]) -> Self {
        let mut source = Self { name: name.to_owned(), modules: BTreeMap::new() };
        let text = |file: &str| files.iter().find(|(name, _)| *name == file).map(|(_, text)| (*text).to_owned());
        source.read_module(&text, files[0].0.to_owned(), Vec::new()).unwrap();
        source
    }

    /// The crate's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn read_module(&mut self, text: &dyn Fn(&str) -> Option<String>, file: String, path: Vec<String>) -> Result<(), String> {
        let source = text(&file).ok_or_else(|| format!("{}: cannot read {file}", self.name))?;
        for module in parse(&path, &source).map_err(|e| format!("{}: {file}: {e}", self.name))? {
            let folder: String = module.path.iter().map(|m| format!("{m}/")).collect();
            for child in &module.children {
                let candidates = [format!("{folder}{child}.rs"), format!("{folder}{child}/mod.rs")];
                let found = candidates.iter().find(|c| text(c).is_some());
                let found = found.ok_or_else(|| format!("{}: {file} declares the module {child}, which has no file", self.name))?;
                let child_path = module.path.iter().cloned().chain([child.clone()]).collect();
                self.read_module(text, found.clone(), child_path)?;
            }
            self.modules.insert(module.path.clone(), (file.clone(), module));
        }
        Ok(())
    }

    /// References between different files, in order of files and lines. Those of one file to another by the same path are one, the first.
    pub fn references(&self) -> Vec<Reference> {
        let mut found = BTreeMap::new();
        self.each_path(|from, path| {
            if let Some(target) = self.definition(&self.absolute(&from.1, &path.segments), 0) {
                let to = &self.modules[&target].0;
                if *to != from.0 {
                    let key = (from.0.clone(), to.clone(), path.segments.join("::"));
                    let line = found.entry(key).or_insert(path.line);
                    *line = path.line.min(*line);
                }
            }
        });
        let mut references: Vec<Reference> = found.into_iter().map(|((from, to, path), line)| Reference { from, to, line, path }).collect();
        references.sort_by(|a, b| (&a.from, a.line, &a.to).cmp(&(&b.from, b.line, &b.to)));
        references
    }

    /// References between top modules as written, before re-exports are followed: `from` and `to` are names of modules. Those of the root file
    /// are left out: it sees everything.
    pub fn room_references(&self) -> Vec<(String, String, Reference)> {
        let mut found = Vec::new();
        self.each_path(|(file, module), path| {
            let Some(room) = module.path.first() else { return };
            let absolute = self.absolute(module, &path.segments);
            let is_room = |name: &String| self.modules.contains_key(std::slice::from_ref(name));
            // A name that the root re-exports belongs to the module that it is from.
            let target = match absolute.first() {
                Some(first) if is_room(first) => Some(first.clone()),
                Some(_) => self.definition(&absolute, 0).and_then(|m| m.first().cloned()),
                None => None,
            };
            if let Some(target) = target.filter(|t| t != room) {
                let reference = Reference { from: file.clone(), to: target.clone(), line: path.line, path: path.segments.join("::") };
                found.push((room.clone(), target, reference));
            }
        });
        found.sort();
        found.dedup();
        found
    }

    /// Calls `visit` for every path in the crate that leads into the crate: those in code, and those of imports that the code needs.
    fn each_path(&self, mut visit: impl FnMut(&(String, Module), &Path)) {
        for entry in self.modules.values() {
            let module = &entry.1;
            for path in &module.paths {
                visit(entry, path);
            }
            for import in &module.imports {
                if import.name == "*" {
                    self.glob(module, import).iter().for_each(|path| visit(entry, path));
                } else if !import.public || module.identifiers.contains(&import.name) {
                    visit(entry, &import.path);
                }
            }
        }
    }

    /// The paths that the identifiers of a module stand for by an import of all names.
    fn glob(&self, module: &Module, import: &Import) -> Vec<Path> {
        let target = self.absolute(module, &import.path.segments);
        let full = |name: &String| target.iter().cloned().chain([name.clone()]).collect::<Vec<_>>();
        let names = module.identifiers.iter().filter(|&name| !module.items.contains(name) && self.exports(&target, name));
        let path = |name| Path { segments: ["crate".to_owned()].into_iter().chain(full(name)).collect(), line: import.path.line };
        names.map(path).collect()
    }

    fn exports(&self, path: &[String], name: &String) -> bool {
        self.modules.get(path).is_some_and(|(_, m)| m.items.contains(name) || m.imports.iter().any(|i| i.name == *name))
    }

    /// The path from the root, for a path as it is written in a module; empty for one that leads to another crate.
    fn absolute(&self, module: &Module, segments: &[String]) -> Vec<String> {
        let mut base = module.path.clone();
        let mut rest = segments;
        let local = |name: &String| self.modules.contains_key(&[&module.path[..], std::slice::from_ref(name)].concat());
        match segments.first().map(String::as_str) {
            Some("crate") => (base, rest) = (Vec::new(), &segments[1..]),
            Some("self") => rest = &segments[1..],
            Some("super") => {
                while let Some("super") = rest.first().map(String::as_str) {
                    base.pop();
                    rest = &rest[1..];
                }
            }
            _ if local(&segments[0]) => (),
            _ => {
                // A name that was imported; `use a::a` would never end.
                let import =
                    module.imports.iter().find(|i| i.name == segments[0] && i.path.segments != segments && i.path.segments[0] != segments[0]);
                let Some(import) = import else { return Vec::new() };
                base = self.absolute(module, &import.path.segments);
                if base.is_empty() {
                    return base;
                }
                rest = &segments[1..];
            }
        }
        base.extend_from_slice(rest);
        base
    }

    /// The module that defines what a path from the root leads to. None for modules themselves and for what is not in the crate.
    fn definition(&self, path: &[String], depth: usize) -> Option<Vec<String>> {
        let known = (0..=path.len()).rev().find(|&n| self.modules.contains_key(&path[..n]))?;
        let (module, name) = (&self.modules[&path[..known]].1, path.get(known)?);
        if module.items.contains(name) || depth > RE_EXPORTS {
            return Some(module.path.clone());
        }
        let follow = |target: &[String]| {
            let full = [target, &path[known + 1..]].concat();
            self.definition(&full, depth + 1)
        };
        if let Some(import) = module.imports.iter().find(|i| i.name == *name) {
            let target = self.absolute(module, &import.path.segments);
            return if target.is_empty() { None } else { follow(&target) };
        }
        let globs = module.imports.iter().filter(|i| i.name == "*").map(|i| self.absolute(module, &i.path.segments));
        for target in globs.filter(|t| !t.is_empty()) {
            if self.exports(&target, name) {
                return follow(&[&target[..], std::slice::from_ref(name)].concat());
            }
        }
        Some(module.path.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrows(files: &[(&str, &str)]) -> Vec<String> {
        let references = CrateSource::from_files("x", files).references();
        references.iter().map(|r| format!("{}:{} -> {}", r.from, r.line, r.to)).collect()
    }

    #[test]
    fn re_exports_are_followed_to_the_file_that_defines() {
        let files = [
            ("lib.rs", "mod a; mod b;"),
            ("a/mod.rs", "mod inner; pub use inner::Thing; pub struct Other;"),
            ("a/inner.rs", "pub struct Thing;"),
            ("b.rs", "use crate::a::Thing;\nuse crate::a;\nfn f() -> a::Other { Thing }"),
        ];
        assert_eq!(arrows(&files), ["b.rs:1 -> a/inner.rs", "b.rs:3 -> a/mod.rs"]);
    }

    #[test]
    fn a_parent_that_only_declares_depends_on_nothing() {
        let parent = ("a/mod.rs", "mod inner; pub use inner::Thing; pub const N: u8 = 1;");
        let child = ("a/inner.rs", "use super::N; pub struct Thing;");
        assert_eq!(arrows(&[("lib.rs", "mod a;"), parent, child]), ["a/inner.rs:1 -> a/mod.rs"]);
        let parent = ("a/mod.rs", "mod inner; pub use inner::Thing;\npub const N: u8 = 1; fn f(t: Thing) {}");
        assert_eq!(arrows(&[("lib.rs", "mod a;"), parent, child]), ["a/inner.rs:1 -> a/mod.rs", "a/mod.rs:1 -> a/inner.rs"]);
    }

    #[test]
    fn names_of_globs_and_inline_paths_count() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c;"),
            ("a.rs", "pub struct A;"),
            ("b.rs", "use crate::a::*; struct B(A);"),
            ("c.rs", "\nstruct C(super::a::A);"),
        ];
        assert_eq!(arrows(&files), ["b.rs:1 -> a.rs", "c.rs:2 -> a.rs"]);
    }

    #[test]
    fn modules_that_attributes_name_count() {
        let numbers = ("a.rs", "use crate::b::B; pub mod numbers { pub fn serialize() {} }");
        let by_path = ("b.rs", "pub struct B(#[serde(with = \"super::a::numbers\")] u8);");
        assert_eq!(arrows(&[("lib.rs", "mod a; mod b;"), numbers, by_path]), ["a.rs:1 -> b.rs", "b.rs:1 -> a.rs"]);
        let by_name = ("b.rs", "use super::a::numbers;\npub struct B(#[serde(with = \"numbers\")] u8);");
        assert_eq!(arrows(&[("lib.rs", "mod a; mod b;"), numbers, by_name]), ["a.rs:1 -> b.rs", "b.rs:2 -> a.rs"]);
    }

    #[test]
    fn rooms_are_those_that_a_path_names() {
        let files = [
            ("lib.rs", "mod a; mod b; pub use a::A;"),
            ("a.rs", "pub struct A;"),
            ("b.rs", "use crate::A; #[cfg(test)] mod tests { use crate::a::Hidden; }"),
        ];
        let found = CrateSource::from_files("x", &files).room_references();
        assert_eq!(found.iter().map(|(f, t, r)| format!("{f} -> {t} {}", r.line)).collect::<Vec<_>>(), ["b -> a 1"]);
    }
}
