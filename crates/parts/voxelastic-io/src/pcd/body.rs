//! The points of a PCD file.

use super::header::{Data, Header};
use super::lzf;
use crate::points::{Column, FieldRoles, RawCloud, Table};
use crate::{Error, Position, Result, StampedCloud};
use std::path::Path;

const TRUNCATED: &str = "the file is truncated: copy or record it again";

pub(super) fn parse(bytes: &[u8], header: &Header, path: &Path) -> Result<StampedCloud> {
    let roles = FieldRoles::of(&header.fields, path)?;
    let body = &bytes[header.body..];
    let raw = match header.data {
        Data::Ascii => {
            let table = Table { path, text: body, first_line: header.lines + 1, rows: header.points, columns: header.numbers };
            let (numbers, rest) = table.read(&roles.fields(&header.fields))?;
            if rest.iter().any(|b| !b.is_ascii_whitespace()) {
                let at = Position::line(header.lines + 1 + header.points);
                let problem = format!("there is more after the {} points that the header claims", header.points);
                return Err(Error::content(path, at, problem, "the header is wrong: write the file again"));
            }
            RawCloud::gather(&header.fields, &roles, |field| numbers.column(field))
        }
        Data::Binary => {
            let needed = header.record.checked_mul(header.points).filter(|&n| n <= body.len());
            let Some(needed) = needed else { return Err(too_short(bytes, body.len() / header.record.max(1), header, path)) };
            RawCloud::gather(&header.fields, &roles, |field| Column {
                bytes: body[..needed].get(field.offset..).unwrap_or(&[]),
                stride: header.record,
                len: header.points,
                scalar: field.scalar,
                big_endian: false,
            })
        }
        Data::Compressed => {
            let unpacked = unpack(bytes, header, path)?;
            // Compressed files hold all of the first field, then all of the second, and so on.
            RawCloud::gather(&header.fields, &roles, |field| Column {
                bytes: unpacked.get(field.offset * header.points..).unwrap_or(&[]),
                stride: field.scalar.size(),
                len: header.points,
                scalar: field.scalar,
                big_endian: false,
            })
        }
    };
    RawCloud { width: header.width, height: header.height, ..raw }.finish(path)
}

/// The numbers of one field of a binary file.
pub(super) fn column(bytes: &[u8], header: &Header, name: &str, path: &Path) -> Result<Vec<f64>> {
    let wrong = |problem: &str| Error::content(path, Position::Field(name.into()), problem, "give a binary PCD file that has this field");
    let field = header.fields.iter().find(|f| f.name == name).ok_or_else(|| wrong("missing"))?;
    if !matches!(header.data, Data::Binary) {
        return Err(wrong("the file is not binary"));
    }
    let body = &bytes[header.body..];
    let needed = header.record.checked_mul(header.points).filter(|&n| n <= body.len());
    let Some(needed) = needed else { return Err(too_short(bytes, body.len() / header.record.max(1), header, path)) };
    let bytes = body[..needed].get(field.offset..).unwrap_or(&[]);
    Ok(Column { bytes, stride: header.record, len: header.points, scalar: field.scalar, big_endian: false }.to_f64())
}

/// Unpacks the body of a compressed file, whose two leading numbers are its packed and unpacked sizes in bytes.
fn unpack(bytes: &[u8], header: &Header, path: &Path) -> Result<Vec<u8>> {
    let body = &bytes[header.body..];
    let size = |k: usize| body.get(k..k + 4).and_then(|b| b.first_chunk::<4>()).map(|b| u32::from_le_bytes(*b) as usize);
    let (Some(packed), Some(unpacked)) = (size(0), size(4)) else { return Err(too_short(bytes, 0, header, path)) };
    if header.record.checked_mul(header.points) != Some(unpacked) {
        let problem = format!("{} points of {} bytes are claimed, but {unpacked} unpacked bytes", header.points, header.record);
        return Err(Error::content(path, Position::Byte(header.body as u64 + 4), problem, "the file is damaged: write it again"));
    }
    let Some(packed) = body.get(8..).and_then(|b| b.get(..packed)) else { return Err(too_short(bytes, 0, header, path)) };
    lzf::unpack(packed, unpacked).map_err(|e| {
        let at = Position::Byte((header.body + 8 + e.offset) as u64);
        Error::content(path, at, format!("the compressed data is damaged: {}", e.problem), "copy or record the file again")
    })
}

fn too_short(bytes: &[u8], held: usize, header: &Header, path: &Path) -> Error {
    let problem = format!("the file ends here, with {held} of the {} points that its header claims", header.points);
    Error::content(path, Position::Byte(bytes.len() as u64), problem, TRUNCATED)
}
