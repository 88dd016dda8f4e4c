//! The header of a PLY file.

use crate::points::{Scalar, split_line};
use crate::{Error, Position, Result};
use std::path::Path;

/// How the elements follow the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    Binary { big_endian: bool },
}

/// A property of an element: one number, or a list of them behind its length.
#[derive(Clone, Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) scalar: Scalar,
    /// Type of the length, for a list.
    pub(super) list: Option<Scalar>,
}

/// An element: rows that all have the same properties.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Bytes of a row in a binary file, unless it holds a list.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, p| if p.list.is_none() { Some(sum + p.scalar.size()) } else { None })
    }
}

/// A header. What it claims about the size of the file is not yet checked.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Offset of the first element in the file.
    pub(super) body: usize,
    /// Lines of the header.
    pub(super) lines: usize,
}

const NOT_PLY: &str = "the file is not a PLY cloud or its header is damaged: convert it again";

pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Header> {
    let (mut encoding, mut elements): (Option<Encoding>, Vec<Element>) = (None, Vec::new());
    let mut rest = bytes;
    for line in 1.. {
        let fail = |problem: String| Err(Error::content(path, Position::line(line), problem, NOT_PLY));
        if rest.is_empty() {
            return fail("the header does not end with end_header".into());
        }
        let (text, after) = split_line(rest);
        rest = after;
        let Ok(text) = std::str::from_utf8(text) else { return fail("the header is not text".into()) };
        let words: Vec<&str> = text.split_ascii_whitespace().take(6).collect();
        match words.as_slice() {
            ["ply"] if line == 1 => {}
            _ if line == 1 => return fail("the file does not begin with ply".into()),
            ["comment" | "obj_info", ..] | [] => {}
            ["format", kind, _] => match *kind {
                "ascii" => encoding = Some(Encoding::Text),
                "binary_little_endian" => encoding = Some(Encoding::Binary { big_endian: false }),
                "binary_big_endian" => encoding = Some(Encoding::Binary { big_endian: true }),
                other => return fail(format!("unknown format {other:?}")),
            },
            ["element", name, count] => match count.parse() {
                Ok(count) => elements.push(Element { name: (*name).into(), count, properties: Vec::new() }),
                Err(_) => return fail(format!("element {name} has the count {count:?}, which is not a number")),
            },
            ["property", declaration @ ..] => match (property(declaration), elements.last_mut()) {
                (Some(property), Some(element)) => element.properties.push(property),
                (None, _) => return fail(format!("property {:?} has no type that PLY knows", declaration.join(" "))),
                (_, None) => return fail("a property before any element".into()),
            },
            ["end_header"] => {
                let Some(encoding) = encoding else { return fail("the header lacks a format line".into()) };
                return Ok(Header { encoding, elements, body: bytes.len() - rest.len(), lines: line });
            }
            _ => return fail(format!("unknown header entry {:?}", text.chars().take(40).collect::<String>())),
        }
    }
    Err(Error::content(path, Position::File, "the header does not end", NOT_PLY))
}

fn property(words: &[&str]) -> Option<Property> {
    match words {
        ["list", length, kind, name] => {
            let length = scalar(length).filter(|s| !s.is_float())?;
            Some(Property { name: (*name).into(), scalar: scalar(kind)?, list: Some(length) })
        }
        [kind, name] => Some(Property { name: (*name).into(), scalar: scalar(kind)?, list: None }),
        _ => None,
    }
}

fn scalar(kind: &str) -> Option<Scalar> {
    Some(match kind {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}
