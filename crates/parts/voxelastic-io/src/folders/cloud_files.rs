//! The cloud files of a folder.

use super::listing::{list, stem_of};
use crate::clouds::CloudFormat;
use crate::{Error, Result, file_names};
use std::cmp::Reverse;
use std::path::{Path, PathBuf};

/// A cloud file.
#[derive(Clone, Debug)]
pub(crate) struct CloudFile {
    pub(crate) path: PathBuf,
    /// The number that its name ends with.
    pub(crate) number: Option<u64>,
    /// The time in its name, seconds since 1970.
    pub(crate) stamp: Option<f64>,
}

/// The clouds of a folder, in order.
///
/// # Errors
/// [`Error::Dataset`] if two formats are equally frequent or there are no clouds; [`Error::Io`].
pub(crate) fn cloud_files_of(folder: &Path) -> Result<Vec<CloudFile>> {
    let files = cloud_files(folder)?;
    if files.is_empty() {
        return Err(Error::dataset(folder, "no clouds in it", "name a folder that holds .pcd, .ply, .bin or .pcd.bin clouds"));
    }
    of_one_format(folder, files).map(|(_, paths, _)| in_order(paths))
}

/// The files of a folder whose names promise scans, with their formats.
pub(super) fn cloud_files(folder: &Path) -> Result<Vec<(CloudFormat, PathBuf)>> {
    Ok(select_clouds(&list(folder)?))
}

/// Names of clouds that are the whole map, or its poses as points, in small letters: LIO-SAM and LeGO-LOAM save these, the systems that came of LIO-SAM beside their scans.
const OF_MAPS: [&str; 9] =
    ["globalmap", "cornermap", "surfmap", "finalcloud", "cloudglobal", "cloudcorner", "cloudsurf", "trajectory", "transformations"];

/// Whether a cloud is that of a map by its name, and no scan.
pub(super) fn is_of_map(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcd")) && OF_MAPS.contains(&stem_of(path).to_ascii_lowercase().as_str())
}

/// The files among `entries` whose names promise scans, with their formats.
pub(super) fn select_clouds(entries: &[PathBuf]) -> Vec<(CloudFormat, PathBuf)> {
    let format = |path: &PathBuf| CloudFormat::of(path).filter(|f| CloudFormat::OF_SCANS.contains(f));
    entries.iter().filter(|e| !is_of_map(e)).filter_map(|e| Some((format(e)?, e.clone()))).filter(|(_, e)| e.is_file()).collect()
}

/// Keeps the files of the most frequent format, since the others are usually maps; also gives a note about files that are ignored.
///
/// # Errors
/// [`Error::Dataset`] if two formats are equally frequent.
pub(super) fn of_one_format(folder: &Path, files: Vec<(CloudFormat, PathBuf)>) -> Result<(CloudFormat, Vec<PathBuf>, Option<String>)> {
    let count = |format| files.iter().filter(|(f, _)| *f == format).count();
    let mut counts = CloudFormat::OF_SCANS.map(|f| (count(f), f));
    counts.sort_by_key(|(n, _)| Reverse(*n));
    let [(most, format), (second, other), ..] = counts;
    if most == second {
        let problem = format!("as many {format} files as {other} files");
        return Err(Error::dataset(folder, problem, "leave the clouds of one format in the folder"));
    }
    let ignored = files.len() - most;
    let note = (ignored > 0).then(|| format!("{ignored} files of another format than {format} are ignored"));
    Ok((format, files.into_iter().filter(|(f, _)| *f == format).map(|(_, p)| p).collect(), note))
}

/// The files in the order of the times in their names if all have one, else in the natural order of their names.
pub(super) fn in_order(mut paths: Vec<PathBuf>) -> Vec<CloudFile> {
    paths.sort_by(|a, b| file_names::natural(&stem_of(a), &stem_of(b)));
    let file = |path: PathBuf| {
        let stem = stem_of(&path);
        CloudFile { number: file_names::number(&stem), stamp: file_names::stamp(&stem), path }
    };
    let mut clouds: Vec<CloudFile> = paths.into_iter().map(file).collect();
    if clouds.iter().all(|c| c.stamp.is_some()) {
        clouds.sort_by(|a, b| a.stamp.unwrap_or(0.0).total_cmp(&b.stamp.unwrap_or(0.0)));
    } else {
        clouds.iter_mut().for_each(|c| c.stamp = None);
    }
    clouds
}

/// The numbers that the names end with, if they are scan numbers: ascending, without duplicates, and no times.
pub(crate) fn scan_numbers(clouds: &[CloudFile]) -> Option<Vec<u64>> {
    let numbers: Option<Vec<u64>> = clouds.iter().map(|c| c.number.filter(|_| c.stamp.is_none())).collect();
    numbers.filter(|n| n.windows(2).all(|pair| pair[0] < pair[1]))
}
