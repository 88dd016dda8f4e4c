//! Tests of the binary `voxelastic`: `first_map` has what works, `inputs/bad_input.rs` has errors and their messages.

// Figures, for those who run the tests with `--nocapture`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod earth;
mod elastic;
mod faults;
mod first_map;
mod inputs;
mod nodes;
mod program;
mod results;
mod room;

use std::path::Path;
use std::process::{Command, Output};

/// The command, in a directory, without the caller's environment for logs.
fn voxelastic(dir: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_voxelastic"));
    command.current_dir(dir).env_remove("RUST_LOG").env_remove("RUST_BACKTRACE");
    command
}

/// Exit code and output of a finished command.
struct Finished {
    code: Option<i32>,
    out: String,
    err: String,
}

impl From<Output> for Finished {
    fn from(output: Output) -> Self {
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        Self { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }
}

/// Runs the command with arguments separated by spaces.
fn run(dir: &Path, arguments: &str) -> Finished {
    voxelastic(dir).args(arguments.split_whitespace()).output().unwrap().into()
}

/// As [`run`], for commands that must succeed; returns stdout.
fn works(dir: &Path, arguments: &str) -> String {
    let finished = run(dir, arguments);
    assert_eq!(finished.code, Some(0), "voxelastic {arguments}\n{}", finished.err);
    finished.out
}

/// As [`works`], for commands that print one JSON object on one line.
fn json(dir: &Path, arguments: &str) -> serde_json::Value {
    let out = works(dir, arguments);
    assert_eq!(out.lines().count(), 1, "{out}");
    serde_json::from_str(&out).unwrap()
}

/// As [`run`], for commands that must fail with `code`, without a panic, and with all of `words` in the message.
fn fails(dir: &Path, arguments: &str, code: i32, words: &[&str]) -> Finished {
    let finished = run(dir, arguments);
    assert_eq!(finished.code, Some(code), "voxelastic {arguments}\n{}", finished.err);
    assert!(finished.err.contains("error: "), "{}", finished.err);
    assert!(!finished.err.contains("panicked") && !finished.err.contains("has a bug"), "{}", finished.err);
    for word in words {
        assert!(finished.err.contains(word), "voxelastic {arguments}: no `{word}` in\n{}", finished.err);
    }
    finished
}
