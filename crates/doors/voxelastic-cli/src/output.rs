//! Results on stdout: text, or one JSON object. Messages on stderr. All that is printed goes through here, so that names and texts of others do nothing to a
//! terminal ([`voxelastic_report::shown`]).

use anyhow::Context;
use serde::{Serialize, Serializer};
use std::io::{self, Write};
use std::path::Path;
use voxelastic_report::shown::{shown_json, shown_lines};

/// Writes `text` to stdout. A closed pipe (`| head`) is not an error.
pub fn print(text: &str) -> anyhow::Result<()> {
    write(&shown_lines(text))
}

fn write(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("cannot write to stdout"),
    }
}

/// Writes `text` to stderr. A stderr that cannot be written (closed terminal, full disk) must not end a run, so errors are ignored.
pub fn message(text: &str) {
    let _ = io::stderr().write_all(shown_lines(text).as_bytes());
}

/// Writes `value` to stdout as one JSON object on one line.
pub fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    let mut text = serde_json::to_string(value).context("cannot write the result as JSON")?;
    text.push('\n');
    write(&shown_json(&text))
}

/// A path as JSON has it: where it is not UTF-8, with what stands for other bytes.
pub fn path<S: Serializer>(path: &impl AsRef<Path>, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.as_ref().to_string_lossy())
}

/// The same, or null.
pub fn optional_path<S: Serializer>(path: &Option<impl AsRef<Path>>, serializer: S) -> Result<S::Ok, S::Error> {
    path.as_ref().map(|path| path.as_ref().to_string_lossy()).serialize(serializer)
}

/// The same for several.
pub fn paths<S: Serializer>(paths: &[impl AsRef<Path>], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(paths.iter().map(|path| path.as_ref().to_string_lossy()))
}
