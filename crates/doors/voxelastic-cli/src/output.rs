//! Results on stdout: text, or one JSON object. Messages on stderr.

use anyhow::Context;
use serde::Serialize;
use std::io::{self, Write};

/// Writes `text` to stdout. A closed pipe (`| head`) is not an error.
pub fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to stdout"),
    }
}

/// Writes `text` to stderr. A stderr that cannot be written (closed terminal, full disk) must not end a run, so errors are ignored.
pub fn message(text: &str) {
    let _ = io::stderr().write_all(text.as_bytes());
}

/// Writes `value` to stdout as one JSON object on one line.
pub fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    let mut text = serde_json::to_string(value).context("cannot write the result as JSON")?;
    text.push('\n');
    print(&text)
}
