//! Clouds of any format.

use crate::survey::{self, SurveyCloud};
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
    /// LAS or LAZ, see [`survey::las`].
    Las,
    /// E57, see [`survey::e57`]; all scans in the file's frame.
    E57,
    /// Bare records of three floats, GLIM's `points_compact.bin`, see [`kitti_bin::parse_bare`].
    BareBin,
}

impl CloudFormat {
    /// Whether scans of a dataset are stored so; the others hold surveys.
    pub(crate) fn holds_scans(self) -> bool {
        matches!(self, Self::Pcd | Self::Ply | Self::KittiBin)
    }

    /// The format that a file's extension promises.
    pub fn of(path: &Path) -> Option<Self> {
        if path.file_name()? == "points_compact.bin" {
            return Some(Self::BareBin);
        }
        let extension = path.extension()?.to_str()?;
        let known = [("pcd", Self::Pcd), ("ply", Self::Ply), ("bin", Self::KittiBin), ("las", Self::Las), ("laz", Self::Las), ("e57", Self::E57)];
        known.into_iter().find(|(e, _)| extension.eq_ignore_ascii_case(e)).map(|(_, f)| f)
    }
}

impl std::fmt::Display for CloudFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Pcd => "PCD",
            Self::Ply => "PLY",
            Self::KittiBin => "KITTI bin",
            Self::Las => "LAS",
            Self::E57 => "E57",
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
        return Err(Error::content(path, Position::File, "not a cloud by its extension", "clouds are .pcd, .ply, .bin, .las, .laz or .e57 files"));
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
        CloudFormat::Las => Ok(bare(survey::las::parse(bytes.to_vec(), path)?, path)),
        CloudFormat::E57 => Ok(bare(survey::e57::merge(&survey::e57::parse(bytes, path)?, path)?, path)),
        CloudFormat::BareBin => kitti_bin::parse_bare(bytes, path),
    }
}

/// The points of a survey; the offset that was taken off is told.
fn bare(survey: SurveyCloud, path: &Path) -> StampedCloud {
    if survey.offset != [0.0; 3] {
        tracing::warn!("{}: coordinates count from {:?} m: they are too large for single precision", path.display(), survey.offset);
    }
    StampedCloud { cloud: survey.cloud, stamp: None }
}
