//! Lists of times: one number of seconds per line.

use crate::text::{self, check_increasing, lines};
use crate::{Error, Position, Result};
use std::path::Path;

/// Reads a list of times in seconds, one per line.
///
/// # Errors
/// [`Error::Content`] if a line is not one finite number, the times do not increase or there are none; [`Error::Io`].
pub fn read_times(path: impl AsRef<Path>) -> Result<Vec<f64>> {
    parse_times(&text::read(path.as_ref())?, path.as_ref())
}

/// Decodes a list of times; `path` is for messages only.
///
/// # Errors
/// As [`read_times`], without [`Error::Io`].
pub fn parse_times(text: &str, path: &Path) -> Result<Vec<f64>> {
    let (mut times, mut numbers) = (Vec::new(), Vec::new());
    for line in lines(path, text) {
        let [time] = line.numbers(line.words(), &["time"])?;
        times.push(time);
        numbers.push(line.number);
    }
    check_increasing(path, &times, &numbers)?;
    if times.is_empty() {
        return Err(Error::content(path, Position::File, "no time in it", "write the file again or remove it"));
    }
    Ok(times)
}
