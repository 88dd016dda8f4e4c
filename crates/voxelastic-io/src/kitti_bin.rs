//! Clouds as KITTI stores them: records of four little-endian f32, `x y z intensity`, and nothing else.

use crate::channels::Raw;
use crate::record::{Column, Scalar, points};
use crate::{Error, Position, Result, StampedCloud, file};
use std::path::Path;

const RECORD: usize = 16;

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
    let spare = bytes.len() % RECORD;
    if spare != 0 {
        let at = Position::Byte((bytes.len() - spare) as u64);
        let problem = format!("the last record has {spare} bytes of {RECORD}");
        return Err(Error::content(
            path,
            at,
            problem,
            "the file is truncated, or not x y z intensity as 32-bit floats: copy it again or convert it to PCD",
        ));
    }
    let len = bytes.len() / RECORD;
    let column = |k: usize| Column { bytes: bytes.get(4 * k..).unwrap_or(&[]), stride: RECORD, len, scalar: Scalar::F32, big_endian: false };
    let points = points([column(0), column(1), column(2)]);
    Raw { points, width: len, height: 1, intensity: Some(column(3).to_f32()), ..Raw::default() }.finish(path)
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
