//! Clouds without a header: records of little-endian 32-bit floats, as KITTI, nuScenes and GLIM write them.

use crate::points::{Column, RawCloud, Scalar, points};
use crate::stamped_cloud::StampedCloud;
use crate::{Error, Position, Result, file};
use std::path::Path;

/// What the floats of a record are. The files do not say: the layout follows from their name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BinLayout {
    /// `x y z`: GLIM's `points_compact.bin`.
    Xyz,
    /// `x y z intensity`: KITTI, SemanticKITTI, KITTI-360, MulRan.
    Kitti,
    /// `x y z intensity ring`: nuScenes (`.pcd.bin`).
    NuScenes,
}

impl BinLayout {
    /// The fields of a record, in order.
    fn fields(self) -> &'static str {
        match self {
            Self::Xyz => "x y z",
            Self::Kitti => "x y z intensity",
            Self::NuScenes => "x y z intensity ring",
        }
    }

    /// Size of a record, bytes.
    fn record_size(self) -> usize {
        match self {
            Self::Xyz => 12,
            Self::Kitti => 16,
            Self::NuScenes => 20,
        }
    }
}

/// Reads a cloud. It is unorganised; the points of Velodyne sensors come ring by ring.
///
/// # Errors
/// [`Error::Content`] if the size is not a multiple of a record's or most numbers cannot be metres (nothing else can be checked without a
/// header); [`Error::NoReturn`], [`Error::Io`].
pub fn read(path: impl AsRef<Path>, layout: BinLayout) -> Result<StampedCloud> {
    parse(&file::read(path.as_ref())?, path.as_ref(), layout)
}

/// Decodes a cloud from the bytes of a file; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(bytes: &[u8], path: &Path, layout: BinLayout) -> Result<StampedCloud> {
    let layout = if layout == BinLayout::Kitti && has_rings(bytes) { BinLayout::NuScenes } else { layout };
    let stride = layout.record_size();
    let excess = bytes.len() % stride;
    if excess != 0 {
        let at = Position::Byte((bytes.len() - excess) as u64);
        let problem = format!("the last record has {excess} of {stride} bytes");
        let remedy = format!("the file is truncated, or not {} as 32-bit floats: copy it again or convert it to PCD", layout.fields());
        return Err(Error::content(path, at, problem, remedy));
    }
    let len = bytes.len() / stride;
    let column = |k: usize| Column { bytes: bytes.get(4 * k..).unwrap_or(&[]), stride, len, scalar: Scalar::F32, big_endian: false };
    let mut cloud = RawCloud { width: len, height: 1, points: points([0, 1, 2].map(column)), ..RawCloud::default() };
    if layout != BinLayout::Xyz {
        cloud.intensity = Some(column(3).to_f32());
    }
    if layout == BinLayout::NuScenes {
        cloud.set_rings(column(4));
    }
    cloud.finish(path)
}

/// Whether records of five floats end with a ring each, as nuScenes' do: of files with four, the numbers at those places would be coordinates.
fn has_rings(bytes: &[u8]) -> bool {
    let (records, rest) = bytes.as_chunks::<20>();
    let ring = |record: &[u8; 20]| f32::from_le_bytes([record[16], record[17], record[18], record[19]]);
    let is_ring = |ring: f32| (0.0..256.0).contains(&ring) && ring.fract() == 0.0;
    let first = records.first().map(ring);
    rest.is_empty() && records.iter().all(|record| is_ring(ring(record))) && records.iter().any(|record| Some(ring(record)) != first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(numbers: &[f32]) -> Vec<u8> {
        numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    #[test]
    fn complete_records_are_read_and_partial_ones_refused() {
        let bytes = bytes(&[1.0, 2.0, 3.0, 0.5, -4.0, 5.0, 6.0, 0.25]);
        let path = Path::new("a.bin");
        let cloud = parse(&bytes, path, BinLayout::Kitti).unwrap().cloud;
        assert_eq!(cloud.points, [[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0]]);
        assert_eq!(cloud.intensity, Some(vec![0.5, 0.25]));
        let error = parse(&bytes[..30], path, BinLayout::Kitti).unwrap_err();
        assert_eq!(error.position(), Position::Byte(16));
        assert!(matches!(parse(&[0; 64], path, BinLayout::Kitti), Err(Error::NoReturn { points: 4, .. })));
        assert!(matches!(parse(&[], path, BinLayout::Kitti), Err(Error::NoReturn { points: 0, .. })));
    }

    #[test]
    fn nuscenes_records_have_a_ring() {
        let cloud = parse(&bytes(&[1.0, 2.0, 3.0, 9.0, 31.0, 4.0, 5.0, 6.0, 7.0, 0.0]), Path::new("a.pcd.bin"), BinLayout::NuScenes).unwrap().cloud;
        assert_eq!((cloud.points[1], cloud.intensity, cloud.ring), ([4.0, 5.0, 6.0], Some(vec![9.0, 7.0]), Some(vec![31, 0])));
        // Whatever the name says: 20 records of five floats are 25 of four, too.
        let numbers: Vec<f32> = (0..20).flat_map(|k| [1.5 + k as f32, 2.25, 3.125, 9.5, (k % 4) as f32]).collect();
        let named_as_kitti = parse(&bytes(&numbers), Path::new("a.bin"), BinLayout::Kitti).unwrap().cloud;
        assert_eq!((named_as_kitti.points.len(), named_as_kitti.points[1]), (20, [2.5, 2.25, 3.125]));
    }
}
