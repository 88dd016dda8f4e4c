//! Clouds as KITTI stores them: records of four little-endian f32, `x y z intensity`, and nothing else.

use crate::channels::Raw;
use crate::record::{Column, Scalar, points};
use crate::{Error, Position, Result, StampedCloud, file};
use std::path::Path;

const RECORD: usize = 16;
/// A record without intensity.
const BARE: usize = 12;

/// Reads a KITTI cloud. It is unorganised; Velodyne points come ring by ring.
///
/// # Errors
/// [`Error::Content`] if the size is not a multiple of a record's or most numbers cannot be metres (the format has
/// no header, so that is all there is to see); [`Error::NoReturn`], [`Error::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<StampedCloud> {
    parse(&file::read(path.as_ref())?, path.as_ref())
}

/// Decodes a KITTI cloud from the bytes of a file; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(bytes: &[u8], path: &Path) -> Result<StampedCloud> {
    let column = records(bytes, path, RECORD, "x y z intensity")?;
    let points = points([column(0), column(1), column(2)]);
    Raw { width: points.len(), height: 1, points, intensity: Some(column(3).to_f32()), ..Raw::default() }.finish(path)
}

/// Decodes records of `x y z` alone, as GLIM's `points_compact.bin` holds them; `path` is for messages only.
///
/// # Errors
/// As [`parse`].
pub fn parse_bare(bytes: &[u8], path: &Path) -> Result<StampedCloud> {
    let column = records(bytes, path, BARE, "x y z")?;
    let points = points([column(0), column(1), column(2)]);
    Raw { width: points.len(), height: 1, points, ..Raw::default() }.finish(path)
}

/// The columns of records of 32-bit floats.
fn records<'a>(bytes: &'a [u8], path: &Path, record: usize, numbers: &str) -> Result<impl Fn(usize) -> Column<'a>> {
    let spare = bytes.len() % record;
    if spare != 0 {
        let at = Position::Byte((bytes.len() - spare) as u64);
        let problem = format!("the last record has {spare} bytes of {record}");
        let remedy = format!("the file is truncated, or not {numbers} as 32-bit floats: copy it again or convert it to PCD");
        return Err(Error::content(path, at, problem, remedy));
    }
    let len = bytes.len() / record;
    Ok(move |k: usize| Column { bytes: bytes.get(4 * k..).unwrap_or(&[]), stride: record, len, scalar: Scalar::F32, big_endian: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_records_and_refuses_parts_of_them() {
        let numbers = [1.0f32, 2.0, 3.0, 0.5, -4.0, 5.0, 6.0, 0.25];
        let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
        let cloud = parse(&bytes, Path::new("a.bin")).unwrap().cloud;
        assert_eq!(cloud.points, [[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0]]);
        assert_eq!(cloud.intensity, Some(vec![0.5, 0.25]));
        let error = parse(&bytes[..30], Path::new("a.bin")).unwrap_err();
        assert_eq!(error.position(), Position::Byte(16));
        assert!(matches!(parse(&[0; 64], Path::new("a.bin")), Err(Error::NoReturn { points: 4, .. })));
        assert!(matches!(parse(&[], Path::new("a.bin")), Err(Error::NoReturn { points: 0, .. })));
    }
}
