//! Licences of dependencies: each must allow to be combined with this project under its own, MIT or Apache-2.0.

use std::path::Path;
use std::process::Command;

/// Licences that ask for no more than attribution. None that reaches over to what is linked with it, such as the GPL.
pub const ALLOWED: [&str; 14] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "bzip2-1.0.6",
    "CC0-1.0",
    "CDLA-Permissive-2.0",
    "ISC",
    "MIT",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Packages under another licence that are used as they are: the MPL asks for the source of its own files, if they are changed, and of no others.
/// `option-ext` is fifty lines that Zenoh needs to find a home directory.
pub const EXCEPTIONS: [(&str, &str); 1] = [("option-ext", "MPL-2.0")];

/// A package and its licence.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Package {
    /// Name and version.
    pub name: String,
    /// The licence as an SPDX expression; empty where the package states none.
    pub licence: String,
}

/// All packages that the workspace is built from, on every platform where their manifests can be had, else on this one.
///
/// # Errors
/// When cargo cannot tell.
pub fn packages(workspace: &Path) -> Result<Vec<Package>, String> {
    let list = |arguments: &[&str]| {
        let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        command.args([
            "tree",
            "--color",
            "never",
            "--workspace",
            "--locked",
            "--prefix",
            "none",
            "--edges",
            "normal,build,dev",
            "--format",
            "{p};{l}",
        ]);
        let output = command.args(arguments).current_dir(workspace).output().map_err(|e| format!("cannot run cargo tree: {e}"))?;
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        if output.status.success() { Ok(text(&output.stdout)) } else { Err(text(&output.stderr)) }
    };
    // Without a network, manifests of packages for other platforms may not be there.
    let text = list(&["--target", "all"]).or_else(|_| list(&["--offline"]))?;
    let package = |line: &str| {
        let (name, licence) = line.strip_suffix(" (*)").unwrap_or(line).split_once(';')?;
        let name = name.split_once(" (").map_or(name, |(name, _)| name);
        Some(Package { name: name.to_owned(), licence: licence.to_owned() })
    };
    let mut packages: Vec<Package> = text.lines().filter_map(package).collect();
    packages.sort();
    packages.dedup();
    Ok(packages)
}

/// Packages whose licence is not allowed, with what to do about it.
///
/// # Errors
/// When cargo cannot tell the packages.
pub fn refused(workspace: &Path) -> Result<Vec<String>, String> {
    let refused = packages(workspace)?.into_iter().filter(|p| !is_allowed(&p.licence) && !is_exception(p));
    let message = |p: Package| {
        format!("{}: licence `{}`. Use another package, or, if its terms allow it, add the licence to ALLOWED in licences.rs.", p.name, p.licence)
    };
    Ok(refused.map(message).collect())
}

/// Whether a package is one of [`EXCEPTIONS`].
fn is_exception(package: &Package) -> bool {
    EXCEPTIONS.iter().any(|(name, licence)| package.licence == *licence && package.name.split(' ').next() == Some(*name))
}

/// Whether an SPDX expression can be satisfied by [`ALLOWED`] licences. A `/` is the old way to write `OR`.
pub fn is_allowed(expression: &str) -> bool {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut words = spaced.split_whitespace().collect::<Vec<_>>();
    words.reverse();
    either(&mut words) && words.is_empty()
}

/// Alternatives, up to the end or a closing bracket; the next word is the last of `words`.
fn either(words: &mut Vec<&str>) -> bool {
    let mut allowed = both(words);
    while words.last() == Some(&"OR") {
        words.pop();
        allowed |= both(words);
    }
    allowed
}

fn both(words: &mut Vec<&str>) -> bool {
    let mut allowed = one(words);
    while words.last() == Some(&"AND") {
        words.pop();
        allowed &= one(words);
    }
    allowed
}

fn one(words: &mut Vec<&str>) -> bool {
    match words.pop() {
        Some("(") => {
            let allowed = either(words);
            words.pop() == Some(")") && allowed
        }
        Some(name) if words.last() == Some(&"WITH") => {
            words.pop();
            let exception = words.pop().unwrap_or_default();
            ALLOWED.contains(&format!("{name} WITH {exception}").as_str())
        }
        Some(name) => ALLOWED.contains(&name),
        None => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_allowed_if_one_way_through_them_is() {
        for expression in
            ["MIT", "MIT/Apache-2.0", "(MIT OR GPL-3.0) AND Unicode-3.0", "Apache-2.0 WITH LLVM-exception OR GPL-2.0", "LGPL-3.0 OR MIT"]
        {
            assert!(is_allowed(expression), "{expression}");
        }
        for expression in ["", "GPL-3.0-only", "MIT AND LGPL-2.1", "(MIT OR Zlib) AND MPL-2.0", "Apache-2.0 WITH Other", "MIT Zlib"] {
            assert!(!is_allowed(expression), "{expression}");
        }
    }
}
