//! Tests that lack something say so, and fail where it is required.
#![allow(clippy::print_stderr)]

use std::fs::OpenOptions;
use std::io::Write;

/// What a test may lack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Recorded data (`VOXELASTIC_DATA`).
    Data,
    /// Python packages (`VOXELASTIC_PYTHON`).
    Python,
    /// Chromium or Chrome.
    Browser,
    /// Node.js and the packages of `.ci/npm` (`VOXELASTIC_NODE_MODULES`).
    Node,
    /// Fast DDS, and what compiles programs for it.
    FastDds,
    /// A property of the system or the user that a test cannot bring about.
    System,
}

impl Need {
    /// The name in `VOXELASTIC_REQUIRE` and in the list of skips.
    pub fn name(self) -> &'static str {
        match self {
            Need::Data => "data",
            Need::Python => "python",
            Need::Browser => "browser",
            Need::Node => "node",
            Need::FastDds => "fastdds",
            Need::System => "system",
        }
    }
}

/// Notes that the current test, or a part of it, is skipped.
///
/// # Panics
/// When `VOXELASTIC_REQUIRE` lists what is missing.
pub fn skip(need: Need, reason: &str) {
    let name = need.name();
    let required = std::env::var("VOXELASTIC_REQUIRE").is_ok_and(|list| list.split(',').any(|n| n.trim() == name));
    assert!(!required, "VOXELASTIC_REQUIRE lists {name}, but {reason}");
    eprintln!("skipped: {reason}");
    if let Some(list) = std::env::var_os("VOXELASTIC_SKIPS") {
        let thread = std::thread::current();
        let line = format!("{name}: {}: {reason}\n", thread.name().unwrap_or("a test"));
        let written = OpenOptions::new().create(true).append(true).open(&list).and_then(|mut file| file.write_all(line.as_bytes()));
        written.unwrap_or_else(|e| panic!("cannot note a skip in {}: {e}", list.to_string_lossy()));
    }
}
