//! What one module declares, imports and refers to.

use crate::tokens::{Token, tokenize, without_tests};
use std::collections::BTreeSet;

/// A module, from a file of its own or inline.
#[derive(Debug, Default)]
pub struct Module {
    /// Path from the crate's root; empty for the root.
    pub path: Vec<String>,
    /// Modules that are declared with `mod name;`, to be read from files.
    pub children: Vec<String>,
    /// Names of the items that are defined here.
    pub items: BTreeSet<String>,
    /// `use` declarations, one for each name.
    pub imports: Vec<Import>,
    /// Paths of two segments or more in the code outside of `use` declarations.
    pub paths: Vec<Path>,
    /// Identifiers in the code outside of `use` declarations.
    pub identifiers: BTreeSet<String>,
}

/// One name that a `use` declaration brings in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Import {
    /// What is imported; for a glob, the module whose names are.
    pub path: Path,
    /// The name here; `*` for a glob, `_` for a trait whose name is not needed.
    pub name: String,
    /// Whether others may use the name: a re-export.
    pub public: bool,
}

/// A path as written, such as `crate::field::Voxel`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Path {
    /// The segments between the colons.
    pub segments: Vec<String>,
    /// Line in the file, from 1.
    pub line: usize,
}

/// Reads the modules in the text of a file: that of the file, and those that it holds inline. Code for tests is left out.
pub fn parse(path: &[String], source: &str) -> Vec<Module> {
    let tokens = without_tests(&tokenize(source));
    let mut parser = Parser { tokens: &tokens, at: 0, modules: Vec::new() };
    parser.module(path.to_vec());
    parser.modules
}

struct Parser<'a> {
    tokens: &'a [Token],
    at: usize,
    modules: Vec<Module>,
}

impl Parser<'_> {
    fn text(&self, ahead: usize) -> &str {
        self.tokens.get(self.at + ahead).map_or("", |t| &t.text)
    }

    /// Reads up to the brace that ends the module or to the end of the file.
    fn module(&mut self, path: Vec<String>) {
        let mut module = Module { path, ..Module::default() };
        let (mut depth, mut public) = (0usize, false);
        while let Some(token) = self.tokens.get(self.at) {
            match token.text.as_str() {
                "}" if depth == 0 => break,
                "}" => depth -= 1,
                "{" => depth += 1,
                "pub" => public = true,
                ";" => public = false,
                "mod" if self.text(2) == ";" => {
                    module.children.push(self.text(1).to_owned());
                    self.at += 1;
                }
                "mod" if self.text(2) == "{" => {
                    let name = self.text(1).to_owned();
                    self.at += 3;
                    self.module(module.path.iter().cloned().chain([name]).collect());
                }
                "use" => {
                    self.at += 1;
                    self.imports(&mut module, Vec::new(), public);
                    public = false;
                    continue;
                }
                keyword @ ("fn" | "struct" | "enum" | "union" | "trait" | "const" | "static" | "type") => {
                    if depth == 0 && self.tokens.get(self.at + 1).is_some_and(Token::is_identifier) && self.text(1) != "fn" {
                        module.items.insert(self.text(1).to_owned());
                    }
                    public = public && keyword == "const"; // `pub const fn`
                }
                "macro_rules" => {
                    module.items.insert(self.text(2).to_owned());
                }
                _ if token.is_identifier() => self.path(&mut module),
                _ => (),
            }
            self.at += 1;
        }
        self.modules.push(module);
    }

    /// Reads a path in code; stops at its last segment.
    fn path(&mut self, module: &mut Module) {
        let line = self.tokens[self.at].line;
        let follows = self.at > 0 && matches!(self.tokens[self.at - 1].text.as_str(), "::" | ".");
        let mut segments = vec![self.text(0).to_owned()];
        while self.text(1) == "::" && self.tokens.get(self.at + 2).is_some_and(Token::is_identifier) {
            self.at += 2;
            segments.push(self.text(0).to_owned());
        }
        module.identifiers.insert(segments[0].clone());
        if segments.len() > 1 && !follows {
            module.paths.push(Path { segments, line });
        }
    }

    /// Reads a tree of imports after `use`, or one in the braces of another; stops after the `;`, or at the `,` or `}` behind it.
    fn imports(&mut self, module: &mut Module, mut segments: Vec<String>, public: bool) {
        let line = self.tokens.get(self.at).map_or(0, |t| t.line);
        let mut name = None;
        let mut is_group = false;
        while let Some(token) = self.tokens.get(self.at) {
            match token.text.as_str() {
                "," | "}" => break,
                ";" => {
                    self.at += 1;
                    break;
                }
                "::" => (),
                "{" => {
                    is_group = true;
                    while !matches!(self.text(0), "}" | "") {
                        self.at += 1;
                        self.imports(module, segments.clone(), public);
                    }
                }
                "as" => {
                    name = Some(self.text(1).to_owned());
                    self.at += 1;
                }
                "*" => name = Some("*".to_owned()),
                segment => segments.push(segment.to_owned()),
            }
            self.at += 1;
        }
        if is_group || segments.is_empty() {
            return;
        }
        if segments.last().is_some_and(|s| s == "self") && segments.len() > 1 {
            segments.pop();
        }
        let name = name.or_else(|| segments.last().cloned()).unwrap_or_default();
        module.imports.push(Import { path: Path { segments, line }, name, public });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn only(source: &str) -> Module {
        parse(&[], source).pop().unwrap()
    }

    #[test]
    fn imports_are_read_name_by_name() {
        let module = only("use a::b;\npub(crate) use super::{c, d::{self, E as F}, g::*};\nuse h as _;");
        let found: Vec<String> = module
            .imports
            .iter()
            .map(|i| format!("{} = {}{} in {}", i.name, i.path.segments.join("::"), if i.public { ", public" } else { "" }, i.path.line))
            .collect();
        let expected = [
            "b = a::b in 1",
            "c = super::c, public in 2",
            "d = super::d, public in 2",
            "F = super::d::E, public in 2",
            "* = super::g, public in 2",
            "_ = h in 3",
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn items_children_and_paths_are_read() {
        let module =
            only("mod a; pub mod b; pub struct C; const fn d() { fn inner() {} crate::e::F::new(); x.g::<H>(); i::J } #[cfg(test)] mod tests;");
        assert_eq!(module.children, ["a", "b"]);
        assert_eq!(module.items.iter().collect::<Vec<_>>(), ["C", "d"]);
        let paths: Vec<String> = module.paths.iter().map(|p| p.segments.join("::")).collect();
        assert_eq!(paths, ["crate::e::F::new", "i::J"]);
    }

    #[test]
    fn inline_modules_are_modules() {
        let modules = parse(&["a".into()], "mod b { use super::C; } struct C;");
        assert_eq!(modules.iter().map(|m| m.path.join("::")).collect::<Vec<_>>(), ["a::b", "a"]);
    }
}
