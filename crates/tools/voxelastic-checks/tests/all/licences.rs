//! Dependencies have licences that go with this project's, and those that read what strangers made are there once.

use std::collections::BTreeMap;
use std::path::Path;
use voxelastic_checks::licences::{packages, refused};

/// What decodes files, and what is said on a network. No database of advisories can be had from a registry; but where there are two versions, one is old.
const READERS: [&str; 20] = [
    "axum",
    "bytes",
    "bzip2",
    "e57",
    "flate2",
    "hyper",
    "image",
    "las",
    "laz",
    "lz4_flex",
    "mcap",
    "miniz_oxide",
    "png",
    "roxmltree",
    "rusqlite",
    "serde_json",
    "tokio",
    "toml",
    "tungstenite",
    "zune-jpeg",
];

/// Second versions that others still need, and who.
const SECOND: [(&str, &str, &str); 5] = [
    ("las", "v0.10", "copc-core, which writes"),
    ("laz", "v0.12", "copc-core"),
    ("lz4_flex", "v0.10", "zenoh-transport, for links with compression, which are not built (RUSTSEC-2026-0041)"),
    ("miniz_oxide", "v0.8", "png"),
    ("toml", "v0.9", "zenoh-config"),
];

fn workspace() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

#[test]
fn all_dependencies_have_an_allowed_licence() {
    assert!(packages(&workspace()).unwrap().len() > 100);
    let refused = refused(&workspace()).unwrap();
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}

#[test]
fn what_reads_what_strangers_made_is_there_once() {
    let mut versions = BTreeMap::<String, Vec<String>>::new();
    for package in packages(&workspace()).unwrap() {
        if let Some((name, version)) = package.name.split_once(' ').filter(|(name, _)| READERS.contains(name)) {
            versions.entry(name.to_owned()).or_default().push(version.to_owned());
        }
    }
    let is_known = |name: &str, version: &str| SECOND.iter().any(|(known, begin, _)| *known == name && version.starts_with(begin));
    for (name, versions) in versions {
        let others: Vec<_> = versions.iter().filter(|version| !is_known(&name, version)).collect();
        assert_eq!(others.len(), 1, "{name}: {versions:?}: update what needs the older one, or name it in SECOND");
    }
}
