//! Reading a cloud of any format, recognised by the file's name.

use crate::bin::{self, BinLayout};
use crate::stamped_cloud::StampedCloud;
use crate::survey::{self, SurveyCloud};
use crate::{Error, Position, Result, file, pcd, ply};
use std::path::Path;

/// File formats of clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CloudFormat {
    /// Point Cloud Library, see [`pcd`].
    Pcd,
    /// Polygon file format, see [`ply`].
    Ply,
    /// KITTI's records of four floats, see [`BinLayout::Kitti`].
    KittiBin,
    /// nuScenes' records of five floats, `.pcd.bin`, see [`BinLayout::NuScenes`].
    NuScenesBin,
    /// LAS or LAZ, see [`survey::las`].
    Las,
    /// E57, see [`survey::e57`]; all scans in the file's frame.
    E57,
    /// GLIM's records of three floats, `points_compact.bin`, see [`BinLayout::Xyz`].
    XyzBin,
}

impl CloudFormat {
    /// Formats that folders of scans come in. The others hold surveys or submaps.
    pub(crate) const OF_SCANS: [Self; 4] = [Self::Pcd, Self::Ply, Self::KittiBin, Self::NuScenesBin];

    /// The format that a file's name promises.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        if name == "points_compact.bin" {
            return Some(Self::XyzBin);
        }
        let known = [
            (".pcd.bin", Self::NuScenesBin),
            (".pcd", Self::Pcd),
            (".ply", Self::Ply),
            (".bin", Self::KittiBin),
            (".las", Self::Las),
            (".laz", Self::Las),
            (".e57", Self::E57),
        ];
        known.into_iter().find(|(ending, _)| name.ends_with(ending) && name.len() > ending.len()).map(|(_, format)| format)
    }
}

impl std::fmt::Display for CloudFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Pcd => "PCD",
            Self::Ply => "PLY",
            Self::KittiBin => "KITTI bin",
            Self::NuScenesBin => "nuScenes bin",
            Self::Las => "LAS",
            Self::E57 => "E57",
            Self::XyzBin => "xyz bin",
        })
    }
}

/// Reads a cloud of any format that this crate knows, recognised by the file's name.
///
/// # Errors
/// [`Error::Content`] if the file breaks its format or its name promises none, [`Error::NoReturn`] if no point of it
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
        CloudFormat::KittiBin => bin::parse(bytes, path, BinLayout::Kitti),
        CloudFormat::NuScenesBin => bin::parse(bytes, path, BinLayout::NuScenes),
        CloudFormat::XyzBin => bin::parse(bytes, path, BinLayout::Xyz),
        CloudFormat::Las => Ok(without_offset(survey::las::parse(bytes.to_vec(), path)?, path)),
        CloudFormat::E57 => Ok(without_offset(survey::e57::merge(&survey::e57::parse(bytes, path)?, path)?, path)),
    }
}

/// The points of a survey. The offset that was subtracted from them is logged.
fn without_offset(survey: SurveyCloud, path: &Path) -> StampedCloud {
    if survey.offset != [0.0; 3] {
        tracing::warn!("{}: coordinates are relative to {:?} m: they are too large for single precision", path.display(), survey.offset);
    }
    StampedCloud::new(survey.cloud, None)
}
