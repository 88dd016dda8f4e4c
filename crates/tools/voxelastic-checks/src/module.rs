//! What one module declares, imports and refers to.

use proc_macro2::{Ident, Span, TokenStream, TokenTree};
use std::collections::BTreeSet;
use syn::ext::IdentExt;
use syn::visit::{self, Visit};
use syn::{Attribute, ImplItem, Item, Meta, Stmt, TraitItem, UseTree};

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
///
/// # Errors
/// When the text is not Rust.
pub fn parse(path: &[String], source: &str) -> Result<Vec<Module>, String> {
    let file = syn::parse_file(source).map_err(|e| format!("line {}: {e}", line(e.span())))?;
    let mut reader = Reader { module: Module { path: path.to_vec(), ..Module::default() }, modules: Vec::new() };
    file.attrs.iter().for_each(|attribute| reader.visit_attribute(attribute));
    reader.items(&file.items);
    reader.modules.push(reader.module);
    Ok(reader.modules)
}

fn line(span: Span) -> usize {
    span.start().line
}

/// Whether only tests are compiled with what has these attributes.
fn is_for_tests(attributes: &[Attribute]) -> bool {
    fn needs_test(condition: &Meta) -> bool {
        let all = syn::punctuated::Punctuated::<Meta, syn::Token![,]>::parse_terminated;
        match condition {
            Meta::Path(path) => path.is_ident("test"),
            Meta::List(list) if list.path.is_ident("all") => list.parse_args_with(all).is_ok_and(|conditions| conditions.iter().any(needs_test)),
            _ => false,
        }
    }
    let is_for_tests = |a: &Attribute| a.path().is_ident("test") || a.path().is_ident("cfg") && a.parse_args().is_ok_and(|c| needs_test(&c));
    attributes.iter().any(is_for_tests)
}

/// The attributes of one of several kinds of syntax, as a slice.
macro_rules! attributes {
    ($syntax:expr, $kind:ident: $($variant:ident)*) => {
        match $syntax {
            $($kind::$variant(syntax) => &syntax.attrs[..],)*
            _ => &[],
        }
    };
}

fn attributes_of_item(item: &Item) -> &[Attribute] {
    attributes!(item, Item: Const Enum ExternCrate Fn ForeignMod Impl Macro Mod Static Struct Trait TraitAlias Type Union Use)
}

/// The name that an item defines in its module.
fn name_of_item(item: &Item) -> Option<&Ident> {
    Some(match item {
        Item::Const(item) => &item.ident,
        Item::Enum(item) => &item.ident,
        Item::Fn(item) => &item.sig.ident,
        Item::Macro(item) => item.ident.as_ref()?,
        Item::Static(item) => &item.ident,
        Item::Struct(item) => &item.ident,
        Item::Trait(item) => &item.ident,
        Item::TraitAlias(item) => &item.ident,
        Item::Type(item) => &item.ident,
        Item::Union(item) => &item.ident,
        _ => return None,
    })
}

struct Reader {
    /// The module that is being read.
    module: Module,
    /// Those that were read.
    modules: Vec<Module>,
}

impl Reader {
    fn items(&mut self, items: &[Item]) {
        let names = items.iter().filter(|item| !is_for_tests(attributes_of_item(item))).filter_map(name_of_item);
        self.module.items.extend(names.map(|name| name.unraw().to_string()));
        items.iter().for_each(|item| self.visit_item(item));
    }

    /// Notes a path in code.
    fn path(&mut self, segments: Vec<String>, line: usize) {
        self.module.identifiers.insert(segments[0].clone());
        if segments.len() > 1 {
            self.module.paths.push(Path { segments, line });
        }
    }

    /// Reads a tree of imports behind a prefix, each name with the line where its part of a group begins.
    fn imports(&mut self, tree: &UseTree, mut segments: Vec<String>, begin: Option<usize>, public: bool) {
        let mut import = |name: String, segments, own: Span| {
            self.module.imports.push(Import { path: Path { segments, line: begin.unwrap_or_else(|| line(own)) }, name, public });
        };
        match tree {
            UseTree::Path(path) => {
                segments.push(path.ident.unraw().to_string());
                self.imports(&path.tree, segments, begin.or_else(|| Some(line(path.ident.span()))), public);
            }
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.imports(tree, segments.clone(), None, public)),
            UseTree::Glob(glob) => import("*".to_owned(), segments, glob.star_token.spans[0]),
            UseTree::Name(name) => {
                if name.ident != "self" {
                    segments.push(name.ident.unraw().to_string());
                }
                import(segments.last().cloned().unwrap_or_default(), segments, name.ident.span());
            }
            UseTree::Rename(name) => {
                if name.ident != "self" || segments.is_empty() {
                    segments.push(name.ident.unraw().to_string());
                }
                import(name.rename.unraw().to_string(), segments, name.ident.span());
            }
        }
    }

    /// Reads the arguments of a macro or of an attribute, in which strings can be paths, too.
    fn tokens(&mut self, tokens: &TokenStream, strings_are_paths: bool) {
        let tokens: Vec<TokenTree> = tokens.clone().into_iter().collect();
        let is = |at: usize, c: char| matches!(tokens.get(at), Some(TokenTree::Punct(p)) if p.as_char() == c);
        let identifier = |at: usize| if let Some(TokenTree::Ident(name)) = tokens.get(at) { Some(name.unraw().to_string()) } else { None };
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            match token {
                TokenTree::Group(group) => self.tokens(&group.stream(), strings_are_paths),
                TokenTree::Ident(first) => {
                    let follows = at > 0 && (is(at - 1, '.') || is(at - 1, ':') && at > 1 && is(at - 2, ':'));
                    let mut segments = vec![first.unraw().to_string()];
                    while let Some(name) = identifier(at + 3).filter(|_| is(at + 1, ':') && is(at + 2, ':')) {
                        segments.push(name);
                        at += 3;
                    }
                    segments.truncate(if follows { 1 } else { segments.len() });
                    self.path(segments, line(first.span()));
                }
                TokenTree::Literal(text) if strings_are_paths => {
                    // `with` names a module, of which functions are used.
                    let of_module = (at > 1 && is(at - 1, '=')).then(|| identifier(at - 2)).flatten().is_some_and(|key| key == "with");
                    if let Ok(path) = syn::parse_str::<syn::LitStr>(&text.to_string()).and_then(|text| text.parse::<syn::Path>()) {
                        let segments = segments(&path).chain(of_module.then(|| "serialize".to_owned()));
                        self.path(segments.collect(), line(text.span()));
                    }
                }
                _ => (),
            }
            at += 1;
        }
    }
}

fn segments(path: &syn::Path) -> impl Iterator<Item = String> {
    path.segments.iter().map(|segment| segment.ident.unraw().to_string())
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item(&mut self, item: &'ast Item) {
        if !is_for_tests(attributes_of_item(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast ImplItem) {
        if !is_for_tests(attributes!(item, ImplItem: Const Fn Type Macro)) {
            visit::visit_impl_item(self, item);
        }
    }

    fn visit_trait_item(&mut self, item: &'ast TraitItem) {
        if !is_for_tests(attributes!(item, TraitItem: Const Fn Type Macro)) {
            visit::visit_trait_item(self, item);
        }
    }

    fn visit_stmt(&mut self, statement: &'ast Stmt) {
        if !is_for_tests(attributes!(statement, Stmt: Local Macro)) {
            visit::visit_stmt(self, statement);
        }
    }

    fn visit_field(&mut self, field: &'ast syn::Field) {
        if !is_for_tests(&field.attrs) {
            visit::visit_field(self, field);
        }
    }

    fn visit_field_value(&mut self, field: &'ast syn::FieldValue) {
        if !is_for_tests(&field.attrs) {
            visit::visit_field_value(self, field);
        }
    }

    fn visit_variant(&mut self, variant: &'ast syn::Variant) {
        if !is_for_tests(&variant.attrs) {
            visit::visit_variant(self, variant);
        }
    }

    fn visit_arm(&mut self, arm: &'ast syn::Arm) {
        if !is_for_tests(&arm.attrs) {
            visit::visit_arm(self, arm);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        let name = item.ident.unraw().to_string();
        let Some((_, items)) = &item.content else { return self.module.children.push(name) };
        let inline = Module { path: self.module.path.iter().cloned().chain([name]).collect(), ..Module::default() };
        let outer = std::mem::replace(&mut self.module, inline);
        self.items(items);
        self.modules.push(std::mem::replace(&mut self.module, outer));
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.imports(&item.tree, Vec::new(), None, !matches!(item.vis, syn::Visibility::Inherited));
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let first = &path.segments[0].ident;
        self.path(segments(path).collect(), line(first.span()));
        path.segments.iter().for_each(|segment| self.visit_path_arguments(&segment.arguments));
    }

    fn visit_ident(&mut self, name: &'ast Ident) {
        self.module.identifiers.insert(name.unraw().to_string());
    }

    fn visit_lifetime(&mut self, _: &'ast syn::Lifetime) {}

    fn visit_meta_list(&mut self, list: &'ast syn::MetaList) {
        self.visit_path(&list.path);
        self.tokens(&list.tokens, true);
    }

    fn visit_token_stream(&mut self, tokens: &'ast TokenStream) {
        self.tokens(tokens, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn only(source: &str) -> Module {
        parse(&[], source).unwrap().pop().unwrap()
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
        let modules = parse(&["a".into()], "mod b { use super::C; } struct C;").unwrap();
        assert_eq!(modules.iter().map(|m| m.path.join("::")).collect::<Vec<_>>(), ["a::b", "a"]);
    }

    #[test]
    fn paths_in_attributes_and_macros_are_read() {
        let module = only(
            "struct A(\n#[serde(with = \"super::numbers\", default = \"B::new\")] u8, #[error(\"c::{0}\")] u8);\nfn f() { g!(x.h::<i>(), $crate::j::K, [r#type::L, &'static m::N]) }",
        );
        let paths: Vec<String> = module.paths.iter().map(|p| format!("{} in {}", p.segments.join("::"), p.line)).collect();
        assert_eq!(paths, ["super::numbers::serialize in 2", "B::new in 2", "crate::j::K in 3", "type::L in 3", "m::N in 3"]);
    }

    #[test]
    fn code_for_tests_is_left_out() {
        let source = "#[cfg(test)] mod tests { fn f() { a::A } } #[cfg(all(test, unix))] use b::B; #[cfg(not(test))] use c::C;
            struct D { #[cfg(test)] e: e::E, g: g::G } impl D { #[cfg(test)] fn h() { h::H } #[test] fn i() { i::I } }
            fn j() { #[cfg(test)] let k = k::K; D { #[cfg(test)] e: l::L, g: m::M } }";
        let module = only(source);
        assert_eq!(module.imports.iter().map(|i| i.name.as_str()).collect::<Vec<_>>(), ["C"]);
        assert_eq!(module.paths.iter().map(|p| p.segments.join("::")).collect::<Vec<_>>(), ["g::G", "m::M"]);
        assert!(parse(&[], "\nfn f( {").unwrap_err().starts_with("line 2"));
    }
}
