//! The `voxelastic` command as its users run it: `feature` is what works, `misc` is what goes wrong and how it is said.

mod colours;
mod corrections;
mod evaluation;
mod feature;
mod misc;
mod occupancy;
mod planning;
mod recordings;
mod report;
mod room;
mod simulation;

use std::path::Path;
use std::process::{Command, Output};

/// The command, in a directory, without the caller's environment for logs.
fn voxelastic(dir: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_voxelastic"));
    command.current_dir(dir).env_remove("RUST_LOG").env_remove("RUST_BACKTRACE");
    command
}

/// What a finished command said.
struct Said {
    code: Option<i32>,
    out: String,
    err: String,
}

impl From<Output> for Said {
    fn from(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        Self { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }
}

/// Runs the command with arguments separated by spaces.
fn run(dir: &Path, arguments: &str) -> Said {
    voxelastic(dir).args(arguments.split_whitespace()).output().unwrap().into()
}

/// As [`run`], for what must work; stdout.
fn works(dir: &Path, arguments: &str) -> String {
    let said = run(dir, arguments);
    assert_eq!(said.code, Some(0), "voxelastic {arguments}\n{}", said.err);
    said.out
}

/// As [`works`], for what prints exactly one JSON object on one line.
fn json(dir: &Path, arguments: &str) -> serde_json::Value {
    let out = works(dir, arguments);
    assert_eq!(out.lines().count(), 1, "{out}");
    serde_json::from_str(&out).unwrap()
}

/// As [`run`], for what must fail with `code`, calmly, and say every one of `words`.
fn fails(dir: &Path, arguments: &str, code: i32, words: &[&str]) -> Said {
    let said = run(dir, arguments);
    assert_eq!(said.code, Some(code), "voxelastic {arguments}\n{}", said.err);
    assert!(said.err.contains("error: "), "{}", said.err);
    assert!(!said.err.contains("panicked") && !said.err.contains("has a bug"), "{}", said.err);
    for word in words {
        assert!(said.err.contains(word), "voxelastic {arguments}: no `{word}` in\n{}", said.err);
    }
    said
}
