//! Points as lines of numbers, the text form of PCD and PLY.

use super::record::{Column, Field, Scalar};
use crate::{Error, Position, Result};
use std::borrow::Cow;
use std::path::Path;

const DAMAGED: &str = "the file is truncated or damaged: copy or write it again";

/// A block of lines, each with the same number of columns.
pub(crate) struct Table<'a> {
    pub(crate) path: &'a Path,
    /// The rest of the file from the first row on.
    pub(crate) text: &'a [u8],
    /// Line number of the first row.
    pub(crate) first_line: usize,
    /// Rows that the header claims.
    pub(crate) rows: usize,
    pub(crate) columns: usize,
}

/// The requested columns of a table, as records of doubles.
pub(crate) struct Numbers {
    bytes: Vec<u8>,
    /// Column of the table that each number of a record came from.
    indices: Vec<usize>,
    rows: usize,
}

impl Numbers {
    /// The column of a field; zeros if it was not requested.
    pub(crate) fn column(&self, field: &Field) -> Column<'_> {
        let at = self.indices.iter().position(|&k| k == field.index).and_then(|k| self.bytes.get(8 * k..));
        Column { bytes: at.unwrap_or(&[]), stride: 8 * self.indices.len(), len: self.rows, scalar: Scalar::F64, big_endian: false }
    }
}

impl<'a> Table<'a> {
    /// Reads the rows; returns the requested columns and the text after the rows. Memory grows with the lines read, not with the count in
    /// the header.
    pub(crate) fn read(&self, wanted: &[&Field]) -> Result<(Numbers, &'a [u8])> {
        let mut wanted: Vec<(usize, &str)> = wanted.iter().map(|f| (f.index, f.name.as_str())).collect();
        wanted.sort_unstable();
        wanted.dedup_by_key(|w| w.0);
        // A number takes at least a digit and a separator.
        let possible = self.rows.min(self.text.len() / (2 * self.columns.max(1)) + 1);
        let mut bytes = Vec::with_capacity(possible * wanted.len() * 8);
        let mut rest = self.text;
        for row in 0..self.rows {
            let line = self.first_line + row;
            if rest.is_empty() {
                let problem = format!("the file ends with {row} of the {} rows that its header claims", self.rows);
                return Err(Error::content(self.path, Position::line(line), problem, DAMAGED));
            }
            let (text, after) = split_line(rest);
            self.row(text, line, &wanted, &mut bytes)?;
            rest = after;
        }
        Ok((Numbers { bytes, indices: wanted.into_iter().map(|(k, _)| k).collect(), rows: self.rows }, rest))
    }

    fn row(&self, text: &[u8], line: usize, wanted: &[(usize, &str)], out: &mut Vec<u8>) -> Result<()> {
        let fail = |problem: String| Error::content(self.path, Position::line(line), problem, DAMAGED);
        let text = std::str::from_utf8(text).map_err(|_| fail("not text".into()))?;
        let mut next = wanted.iter().peekable();
        let mut count = 0;
        for word in text.split_ascii_whitespace() {
            if let Some((_, name)) = next.next_if(|(index, _)| *index == count) {
                let number: f64 = word.parse().map_err(|_| {
                    let at = Position::Line { line, field: Some(Cow::Owned((*name).to_owned())) };
                    let word: String = word.chars().take(40).collect();
                    Error::content(self.path, at, format!("{word:?} is not a number"), DAMAGED)
                })?;
                out.extend_from_slice(&number.to_le_bytes());
            }
            count += 1;
        }
        if count == self.columns { Ok(()) } else { Err(fail(format!("{count} numbers instead of {}", self.columns))) }
    }
}

/// The first line without its end, and what follows it.
pub(crate) fn split_line(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text.iter().position(|&b| b == b'\n').unwrap_or(text.len());
    (&text[..end], text.get(end + 1..).unwrap_or(&[]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(name: &str, index: usize) -> Field {
        Field { name: name.into(), scalar: Scalar::F32, count: 1, offset: 0, index }
    }

    fn table(text: &str, rows: usize) -> Table<'_> {
        Table { path: Path::new("a"), text: text.as_bytes(), first_line: 5, rows, columns: 3 }
    }

    #[test]
    fn wanted_columns_in_any_order() {
        let (c, a) = (field("c", 2), field("a", 0));
        let (numbers, rest) = table("1 x 3\r\n4 y nan\nrest", 2).read(&[&c, &a]).unwrap();
        assert_eq!(numbers.column(&a).to_f64(), [1.0, 4.0]);
        let c = numbers.column(&c).to_f64();
        assert!(c[0] == 3.0 && c[1].is_nan());
        assert_eq!(rest, b"rest");
    }

    #[test]
    fn errors_name_line_and_field() {
        let a = field("a", 1);
        let at = |text, rows| table(text, rows).read(&[&a]).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(at("1 2 3\n1 b 3\n", 2).contains("line 6, field a: \"b\" is not a number"));
        assert!(at("1 2 3\n1 2\n", 2).contains("line 6: 2 numbers instead of 3"));
        assert!(at("1 2 3\n", usize::MAX).contains("line 6: the file ends with 1 of the"));
    }
}
