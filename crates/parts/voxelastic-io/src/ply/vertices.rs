//! The elements of a PLY file: skipping to one, and the vertices.

use super::header::{Element, Encoding, Header, Property};
use crate::points::{Column, Field, FieldRoles, Numbers, RawCloud, Scalar, Table, split_line};
use crate::{Error, Position, Result, StampedCloud};
use std::path::Path;

pub(super) const TRUNCATED: &str = "the file is truncated or damaged: copy or write it again";

/// A place between two elements.
#[derive(Clone, Copy)]
pub(super) struct Cursor<'a> {
    pub(super) path: &'a Path,
    pub(super) rest: &'a [u8],
    /// Size of the whole file, to name byte offsets.
    pub(super) total: usize,
    /// Number of the line that comes next, in text files.
    pub(super) line: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn after(header: &Header, bytes: &'a [u8], path: &'a Path) -> Self {
        Self { path, rest: &bytes[header.body..], total: bytes.len(), line: header.lines + 1 }
    }

    /// Where the cursor stands, for messages.
    pub(super) fn position(&self, encoding: Encoding) -> Position {
        match encoding {
            Encoding::Text => Position::line(self.line),
            Encoding::Binary { .. } => Position::Byte((self.total - self.rest.len()) as u64),
        }
    }

    pub(super) fn ends(&self, encoding: Encoding, element: &Element, row: usize) -> Error {
        let problem = format!("the file ends within row {row} of the {} rows of element {} that its header claims", element.count, element.name);
        Error::content(self.path, self.position(encoding), problem, TRUNCATED)
    }

    /// Takes bytes of a binary file.
    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(taken)
    }

    /// Takes a line of a text file.
    pub(super) fn take_line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let (line, rest) = split_line(self.rest);
        (self.rest, self.line) = (rest, self.line + 1);
        Some(line)
    }

    /// Takes the length of a list and the bytes of its numbers.
    pub(super) fn take_list(&mut self, length: Scalar, property: &Property, big_endian: bool) -> Option<(usize, &'a [u8])> {
        let bytes = self.take(length.size())?;
        let count = Column { bytes, stride: length.size(), len: 1, scalar: length, big_endian }.to_f64().first().copied()?;
        if count < 0.0 {
            return None;
        }
        let count = count as usize;
        Some((count, self.take(count.checked_mul(property.scalar.size())?)?))
    }

    /// Skips all rows of an element.
    fn skip(&mut self, element: &Element, encoding: Encoding) -> Result<()> {
        match (encoding, element.stride()) {
            (Encoding::Text, _) => {
                for row in 0..element.count {
                    self.take_line().ok_or_else(|| self.ends(encoding, element, row))?;
                }
            }
            (Encoding::Binary { .. }, Some(stride)) => {
                stride.checked_mul(element.count).and_then(|n| self.take(n)).ok_or_else(|| self.ends(encoding, element, 0))?;
            }
            (Encoding::Binary { big_endian }, None) => {
                for row in 0..element.count {
                    for property in &element.properties {
                        let taken = match property.list {
                            Some(length) => self.take_list(length, property, big_endian).map(|_| ()),
                            None => self.take(property.scalar.size()).map(|_| ()),
                        };
                        taken.ok_or_else(|| self.ends(encoding, element, row))?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Skips to the element of the given name.
    pub(super) fn seek<'h>(&mut self, header: &'h Header, elements: &mut std::slice::Iter<'h, Element>, name: &str) -> Result<Option<&'h Element>> {
        for element in elements {
            if element.name == name {
                return Ok(Some(element));
            }
            self.skip(element, header.encoding)?;
        }
        Ok(None)
    }
}

/// The rows of an element without lists.
pub(super) enum Rows<'a> {
    Binary { bytes: &'a [u8], stride: usize, len: usize, big_endian: bool },
    Text(Numbers),
}

impl Rows<'_> {
    pub(super) fn column(&self, field: &Field) -> Column<'_> {
        match self {
            Self::Binary { bytes, stride, len, big_endian } => {
                Column { bytes: bytes.get(field.offset..).unwrap_or(&[]), stride: *stride, len: *len, scalar: field.scalar, big_endian: *big_endian }
            }
            Self::Text(numbers) => numbers.column(field),
        }
    }
}

/// The vertices' fields; an error if the file has no vertices or they hold lists.
pub(super) fn fields(vertex: Option<&Element>, path: &Path) -> Result<Vec<Field>> {
    let fail =
        |problem: &str| Err(Error::content(path, Position::Field("vertex".into()), problem, "write the points as x, y and z of the element vertex"));
    let Some(vertex) = vertex else { return fail("the file has no vertices") };
    if vertex.stride().is_none() {
        return fail("the vertices hold lists");
    }
    let mut offset = 0;
    let field = |(index, p): (usize, &Property)| {
        let field = Field { name: p.name.clone(), scalar: p.scalar, count: 1, offset, index };
        offset += p.scalar.size();
        field
    };
    Ok(vertex.properties.iter().enumerate().map(field).collect())
}

/// Takes the rows of an element without lists; of a text file, the wanted fields only.
pub(super) fn rows<'a>(cursor: &mut Cursor<'a>, element: &Element, encoding: Encoding, wanted: &[&Field]) -> Result<Rows<'a>> {
    match encoding {
        Encoding::Binary { big_endian } => {
            let stride = element.stride().unwrap_or(0);
            let held = cursor.rest.len() / stride.max(1);
            let bytes = stride.checked_mul(element.count).and_then(|n| cursor.take(n)).ok_or_else(|| cursor.ends(encoding, element, held))?;
            Ok(Rows::Binary { bytes, stride, len: element.count, big_endian })
        }
        Encoding::Text => {
            let table =
                Table { path: cursor.path, text: cursor.rest, first_line: cursor.line, rows: element.count, columns: element.properties.len() };
            let (numbers, rest) = table.read(wanted)?;
            (cursor.rest, cursor.line) = (rest, cursor.line + element.count);
            Ok(Rows::Text(numbers))
        }
    }
}

/// The vertices as a cloud.
pub(super) fn cloud(bytes: &[u8], header: &Header, path: &Path) -> Result<StampedCloud> {
    let mut cursor = Cursor::after(header, bytes, path);
    let vertex = cursor.seek(header, &mut header.elements.iter(), "vertex")?;
    let fields = fields(vertex, path)?;
    let roles = FieldRoles::of(&fields, path)?;
    let Some(vertex) = vertex else { return Err(Error::NoReturn { path: path.into(), points: 0 }) };
    let rows = rows(&mut cursor, vertex, header.encoding, &roles.fields(&fields))?;
    let raw = RawCloud::gather(&fields, &roles, |field| rows.column(field));
    RawCloud { width: vertex.count, height: 1, ..raw }.finish(path)
}
