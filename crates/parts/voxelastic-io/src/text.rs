//! Lines of numbers with errors that name the line and the field.

use crate::{Error, Position, Result, file};
use nalgebra::{Quaternion, UnitQuaternion};
use std::borrow::Cow;
use std::path::Path;
use voxelastic::Pose;

/// A quaternion or rotation matrix may be off by this much, the rounding of files with few digits; more is an error.
pub(crate) const ROTATION_TOLERANCE: f64 = 1e-2;

/// Reads a text file.
pub(crate) fn read(path: &Path) -> Result<String> {
    String::from_utf8(file::read(path)?).map_err(|e| {
        let at = Position::Byte(e.utf8_error().valid_up_to() as u64);
        Error::content(path, at, "not a text file", "give a file of text, or write it again in UTF-8")
    })
}

/// A line of a text file that is neither empty nor a comment.
#[derive(Clone, Copy)]
pub(crate) struct Line<'a> {
    pub(crate) path: &'a Path,
    /// 1-based.
    pub(crate) number: usize,
    pub(crate) text: &'a str,
}

/// The lines that hold something; comments begin with `#` or `%`.
pub(crate) fn lines<'a>(path: &'a Path, text: &'a str) -> impl Iterator<Item = Line<'a>> {
    let line = move |(k, text): (usize, &'a str)| Line { path, number: k + 1, text: text.trim() };
    text.lines().enumerate().map(line).filter(|l| !l.text.is_empty() && !l.text.starts_with(['#', '%']))
}

impl<'a> Line<'a> {
    /// The words between spaces, tabs or commas.
    pub(crate) fn words(&self) -> impl Iterator<Item = &'a str> + use<'a> {
        words(self.text)
    }

    pub(crate) fn error(&self, problem: impl Into<String>, remedy: &'static str) -> Error {
        Error::content(self.path, Position::line(self.number), problem, remedy)
    }

    /// An error of one field.
    pub(crate) fn field_error(&self, field: impl Into<Cow<'static, str>>, problem: impl Into<String>, remedy: &'static str) -> Error {
        let at = Position::Line { line: self.number, field: Some(field.into()) };
        Error::content(self.path, at, problem, remedy)
    }

    /// Parses words as finite numbers with the given names; fewer or more words are an error.
    pub(crate) fn numbers<const N: usize>(&self, words: impl Iterator<Item = &'a str>, names: &[&'static str; N]) -> Result<[f64; N]> {
        let mut words = words;
        let mut numbers = [0.0; N];
        for (slot, name) in numbers.iter_mut().zip(names) {
            let word = words.next().ok_or_else(|| self.field_error(*name, "missing", TRUNCATED))?;
            *slot = self.number(word, name)?;
        }
        match words.next() {
            None => Ok(numbers),
            Some(word) => {
                Err(self.error(format!("unexpected {:?} after {}", short(word), names[N - 1]), "remove it, or choose the format that the file is in"))
            }
        }
    }

    /// Parses a word as a finite number.
    pub(crate) fn number(&self, word: &str, name: &'static str) -> Result<f64> {
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(self.field_error(name, format!("{word} is not finite"), "remove the line or write the file again")),
            Err(_) => Err(self.field_error(name, format!("{:?} is not a number", short(word)), "correct it or write the file again")),
        }
    }

    /// Parses a word as an integer without sign.
    pub(crate) fn integer(&self, word: Option<&str>, name: &'static str) -> Result<u64> {
        let word = word.ok_or_else(|| self.field_error(name, "missing", TRUNCATED))?;
        word.parse()
            .map_err(|_| self.field_error(name, format!("{:?} is not a whole number from 0", short(word)), "correct it or write the file again"))
    }

    /// A pose from `x y z qx qy qz qw`. A quaternion that is slightly off is normalised.
    pub(crate) fn pose(&self, [x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Result<Pose> {
        let q = Quaternion::new(qw, qx, qy, qz);
        let norm = q.norm();
        if (norm - 1.0).abs() > ROTATION_TOLERANCE {
            let problem = format!("the quaternion has length {norm:.4}, not 1");
            return Err(self.field_error("qx qy qz qw", problem, "check the order of the columns (x y z, then qx qy qz qw) or write the file again"));
        }
        // Numbers that are already a unit quaternion, to the last bit or two, are kept as they are.
        let rotation = if (norm - 1.0).abs() < 4.0 * f64::EPSILON { UnitQuaternion::new_unchecked(q) } else { UnitQuaternion::new_normalize(q) };
        Ok(Pose::from_parts([x, y, z].into(), rotation))
    }
}

/// What a line that ends early suggests.
pub(crate) const TRUNCATED: &str = "the file is truncated or of another format: copy or write it again";

pub(crate) fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split([' ', '\t', ',']).filter(|w| !w.is_empty())
}

/// A word cut to what fits a message.
pub(crate) fn short(word: &str) -> String {
    word.chars().take(40).collect()
}

/// Checks that times increase; names both lines otherwise.
pub(crate) fn check_increasing(path: &Path, times: &[f64], line_numbers: &[usize]) -> Result<()> {
    for k in 1..times.len() {
        if times[k] <= times[k - 1] {
            let line = Line { path, number: line_numbers[k], text: "" };
            let problem = format!("{} is not after {} of line {}", times[k], times[k - 1], line_numbers[k - 1]);
            return Err(line.field_error("time", problem, "sort the lines by time and remove duplicates"));
        }
    }
    Ok(())
}
