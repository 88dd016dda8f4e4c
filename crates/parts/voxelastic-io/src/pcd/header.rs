//! The header of a PCD file.

use crate::points::{Field, Scalar};
use crate::{Error, Position, Result};
use std::path::Path;

/// How the points follow the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Data {
    Ascii,
    Binary,
    Compressed,
}

/// A header whose parts agree with each other. What it claims about the size of the file is not yet checked.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) fields: Vec<Field>,
    /// Bytes of a point.
    pub(super) record: usize,
    /// Numbers of a point.
    pub(super) numbers: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) points: usize,
    pub(super) data: Data,
    /// Offset of the points in the file.
    pub(super) body: usize,
    /// Lines of the header.
    pub(super) lines: usize,
}

/// The header's entries as they stand.
#[derive(Default)]
struct Entries<'a> {
    names: Vec<&'a str>,
    sizes: Option<Vec<&'a str>>,
    types: Option<Vec<&'a str>>,
    counts: Option<Vec<&'a str>>,
    width: Option<usize>,
    height: Option<usize>,
    points: Option<usize>,
}

const NOT_PCD: &str = "the file is not a PCD cloud or its header is damaged: convert it again";

pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Header> {
    let mut entries = Entries::default();
    let mut offset = 0;
    let mut line = 0;
    loop {
        line += 1;
        let Some(length) = bytes[offset..].iter().position(|&b| b == b'\n') else {
            return Err(Error::content(path, Position::Byte(bytes.len() as u64), "the header does not end with a DATA line", NOT_PCD));
        };
        let words = std::str::from_utf8(&bytes[offset..offset + length]);
        offset += length + 1;
        let words = words.map_err(|_| Error::content(path, Position::line(line), "the header is not text", NOT_PCD))?;
        let mut words = words.split_ascii_whitespace();
        let Some(key) = words.next().filter(|k| !k.starts_with('#')) else { continue };
        if key == "DATA" {
            let data = match words.next() {
                Some("ascii") => Data::Ascii,
                Some("binary") => Data::Binary,
                Some("binary_compressed") => Data::Compressed,
                other => {
                    let problem = format!("DATA is {:?}", other.unwrap_or_default());
                    return Err(Error::content(path, Position::line(line), problem, "it must be ascii, binary or binary_compressed"));
                }
            };
            return entries.assemble(
                Header { fields: Vec::new(), record: 0, numbers: 0, width: 0, height: 0, points: 0, data, body: offset, lines: line },
                path,
            );
        }
        entries.take(key, words, line, path)?;
    }
}

impl<'a> Entries<'a> {
    fn take(&mut self, key: &str, words: std::str::SplitAsciiWhitespace<'a>, line: usize, path: &Path) -> Result<()> {
        let number = |mut words: std::str::SplitAsciiWhitespace<'a>| {
            let word = words.next().unwrap_or("");
            let problem = || Error::content(path, Position::line(line), format!("{key} is {word:?}, not a number"), NOT_PCD);
            word.parse::<usize>().map_err(|_| problem()).map(Some)
        };
        match key {
            "VERSION" | "VIEWPOINT" => {}
            "FIELDS" | "COLUMNS" => self.names = words.collect(),
            "SIZE" => self.sizes = Some(words.collect()),
            "TYPE" => self.types = Some(words.collect()),
            "COUNT" => self.counts = Some(words.collect()),
            "WIDTH" => self.width = number(words)?,
            "HEIGHT" => self.height = number(words)?,
            "POINTS" => self.points = number(words)?,
            _ => {
                let key: String = key.chars().take(40).collect();
                return Err(Error::content(path, Position::line(line), format!("unknown header entry {key:?}"), NOT_PCD));
            }
        }
        Ok(())
    }

    fn assemble(self, mut header: Header, path: &Path) -> Result<Header> {
        let fail = |problem: String| Err(Error::content(path, Position::File, problem, NOT_PCD));
        let count = self.names.len();
        let (Some(sizes), Some(types)) = (&self.sizes, &self.types) else { return fail("the header lacks SIZE or TYPE".into()) };
        let listed = [Some(sizes), Some(types), self.counts.as_ref()];
        if count == 0 || listed.iter().flatten().any(|l| l.len() != count) {
            return fail(format!("the header lists {count} FIELDS, but another number of SIZE, TYPE or COUNT"));
        }
        for k in 0..count {
            let repeat = self.counts.as_ref().map_or("1", |c| c[k]);
            let (Some(scalar), Ok(repeat)) = (scalar(types[k], sizes[k]), repeat.parse::<usize>()) else {
                let problem = format!("has type {} of size {} and count {repeat}", types[k], sizes[k]);
                return Err(Error::content(
                    path,
                    Position::Field(self.names[k].into()),
                    problem,
                    "types are F of 4 or 8, I or U of 1, 2, 4 or 8 bytes",
                ));
            };
            header.fields.push(Field { name: self.names[k].into(), scalar, count: repeat, offset: header.record, index: header.numbers });
            let sum = |total: usize, each: usize| each.checked_mul(repeat).and_then(|part| total.checked_add(part));
            match (sum(header.record, scalar.size()), sum(header.numbers, 1)) {
                (Some(record), Some(numbers)) => (header.record, header.numbers) = (record, numbers),
                _ => return fail(format!("field {} has {repeat} numbers", self.names[k])),
            }
        }
        let Some(width) = self.width.or(self.points) else { return fail("the header lacks WIDTH and POINTS".into()) };
        header.width = width;
        header.height = self.height.unwrap_or(1);
        let Some(points) = header.width.checked_mul(header.height) else { return fail("WIDTH x HEIGHT overflows".into()) };
        if self.points.is_some_and(|p| p != points) {
            return fail(format!("POINTS is {}, but WIDTH x HEIGHT is {points}", self.points.unwrap_or(0)));
        }
        header.points = points;
        Ok(header)
    }
}

fn scalar(kind: &str, size: &str) -> Option<Scalar> {
    Some(match (kind, size) {
        ("I", "1") => Scalar::I8,
        ("I", "2") => Scalar::I16,
        ("I", "4") => Scalar::I32,
        ("I", "8") => Scalar::I64,
        ("U", "1") => Scalar::U8,
        ("U", "2") => Scalar::U16,
        ("U", "4") => Scalar::U32,
        ("U", "8") => Scalar::U64,
        ("F", "4") => Scalar::F32,
        ("F", "8") => Scalar::F64,
        _ => return None,
    })
}
