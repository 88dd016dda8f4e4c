//! Clouds of any format.

use crate::{Error, Position, Result, file, kitti_bin, pcd, ply};
use std::path::Path;
use voxelastic::Cloud;

/// A cloud and, where its file says so, when it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedCloud {
    /// The points, in the lidar frame.
    pub cloud: Cloud,
    /// Time in seconds that [`Cloud::time`] counts from. Present only if the file holds absolute times.
    pub stamp: Option<f64>,
}

/// File formats of clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CloudFormat {
    /// Point Cloud Library, see [`pcd`].
    Pcd,
    /// Polygon file format, see [`ply`].
    Ply,
    /// KITTI's records of four floats, see [`kitti_bin`].
    KittiBin,
    /// Bare records of three floats, GLIM's `points_compact.bin`, see [`kitti_bin::parse_bare`].
    BareBin,
}

impl CloudFormat {
    /// The format that a file's extension promises.
    pub fn of(path: &Path) -> Option<Self> {
        if path.file_name()? == "points_compact.bin" {
            return Some(Self::BareBin);
        }
        let extension = path.extension()?.to_str()?;
        [("pcd", Self::Pcd), ("ply", Self::Ply), ("bin", Self::KittiBin)].into_iter().find(|(e, _)| extension.eq_ignore_ascii_case(e)).map(|(_, f)| f)
    }
}

impl std::fmt::Display for CloudFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Pcd => "PCD",
            Self::Ply => "PLY",
            Self::KittiBin => "KITTI bin",
            Self::BareBin => "bare bin",
        })
    }
}

/// Reads a cloud of any format that this crate knows, by the file's extension.
///
/// # Errors
/// [`Error::Content`] if the file breaks its format or has another extension, [`Error::NoReturn`] if no point of it
/// is a measurement, [`Error::Io`] if it cannot be read.
pub fn read(path: impl AsRef<Path>) -> Result<StampedCloud> {
    let path = path.as_ref();
    let Some(format) = CloudFormat::of(path) else {
        return Err(Error::content(path, Position::File, "not a cloud by its extension", "clouds are .pcd, .ply or .bin files"));
    };
    parse(&file::read(path)?, path, format)
}

/// Decodes a cloud from the bytes of a file; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(bytes: &[u8], path: &Path, format: CloudFormat) -> Result<StampedCloud> {
    match format {
        CloudFormat::Pcd => pcd::parse(bytes, path),
        CloudFormat::Ply => ply::parse_cloud(bytes, path),
        CloudFormat::KittiBin => kitti_bin::parse(bytes, path),
        CloudFormat::BareBin => kitti_bin::parse_bare(bytes, path),
    }
}
