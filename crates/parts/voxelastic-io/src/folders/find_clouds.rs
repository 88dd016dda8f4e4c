//! Finding the clouds of a folder by its layout.
//!
//! ```text
//! scans/ velodyne/ clouds/ lidar/ pcd/ points/ ..    a folder of clouds with a usual name, or `data` in it
//! velodyne_points/data/                              KITTI raw and KITTI-360
//! samples/LIDAR_TOP/ and sweeps/LIDAR_TOP/           nuScenes: keyframes and the sweeps between them, taken together
//! (the folder itself)
//! anything/, anything/anything/, ..                  the only folder with two or more clouds, a few levels down
//! ```

use super::cloud_files::{CloudFile, cloud_files, in_order, is_of_map, of_one_format, select_clouds};
use super::listing::{list, name_of};
use crate::clouds::CloudFormat;
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Usual names of subfolders with clouds, in lower case. A name of the first group is preferred to those of the second.
const USUAL_NAMES: [&[&str]; 2] = [
    &["scans", "velodyne", "clouds"],
    &[
        "velodyne_points",
        "lidar",
        "lidars",
        "lidar_top",
        "lidar_points",
        "ouster",
        "pcd",
        "pcds",
        "points",
        "pointcloud",
        "pointclouds",
        "point_cloud",
        "point_clouds",
    ],
];
/// nuScenes: keyframes, and the sweeps between them.
const NUSCENES: [&str; 2] = ["samples/LIDAR_TOP", "sweeps/LIDAR_TOP"];
/// Levels below the folder that are searched for clouds in folders of any name: those of a whole KITTI-360 download.
const SEARCH_DEPTH: usize = 4;
/// Most folders that the search lists.
const MOST_FOLDERS: usize = 5_000;
/// Fewer clouds do not make a folder of any name one of scans: it may hold a map.
const FEWEST_CLOUDS: usize = 2;
/// Most choices that an error lists.
const MOST_CHOICES: usize = 8;

/// The clouds of a folder.
#[derive(Clone, Debug)]
pub(crate) struct CloudFolder {
    /// The folder of the clouds, relative to the folder that was searched; empty for that folder itself.
    pub(crate) relative: PathBuf,
    /// Format of the clouds.
    pub(crate) format: CloudFormat,
    /// The clouds in their order.
    pub(crate) clouds: Vec<CloudFile>,
    /// Remarks for the user.
    pub(crate) notes: Vec<String>,
}

/// Finds the clouds of a folder.
///
/// # Errors
/// [`Error::Dataset`] if there are none, if several folders could be meant, or if two formats are equally frequent; [`Error::Io`].
pub(crate) fn find_clouds(path: &Path) -> Result<CloudFolder> {
    if let Some(found) = in_usual_places(path)? {
        return Ok(found);
    }
    let folders = search(path)?;
    match folders.as_slice() {
        [] => {
            refuse_map(path)?;
            let problem = "no clouds in scans/, velodyne/, velodyne_points/data/, clouds/, lidar/, pcd/, points/, the folder itself or below it";
            Err(Error::dataset(path, problem, "name a folder that holds .pcd, .ply, .bin or .pcd.bin clouds"))
        }
        [only] => read_folder(path, only),
        several => Err(several_folders(path, several)),
    }
}

/// Says of a folder without scans that it holds a map.
fn refuse_map(path: &Path) -> Result<()> {
    let names: Vec<String> = list(path)?.iter().filter(|file| is_of_map(file)).map(|file| name_of(file)).collect();
    if names.is_empty() {
        return Ok(());
    }
    let poses = if names.iter().any(|name| name == "transformations.pcd") { ", with `--poses transformations.pcd`" } else { "" };
    let problem = format!("a map and its poses, not scans: {}", names.join(", "));
    Err(Error::dataset(path, problem, format!("map the recording that it was made of{poses}")))
}

/// Whether a folder holds clouds in one of the usual places.
pub(crate) fn holds_clouds(path: &Path) -> bool {
    matches!(in_usual_places(path), Ok(Some(_)))
}

/// The clouds in a subfolder of a usual name, else in the folder itself.
fn in_usual_places(path: &Path) -> Result<Option<CloudFolder>> {
    let entries = list(path)?;
    for names in USUAL_NAMES {
        let is_usual = |e: &&PathBuf| names.contains(&name_of(e).to_ascii_lowercase().as_str()) && e.is_dir();
        let with_clouds = |folder: &PathBuf| cloud_files(folder).is_ok_and(|clouds| !clouds.is_empty());
        let found: Vec<PathBuf> = entries.iter().filter(is_usual).filter_map(|e| [e.clone(), e.join("data")].into_iter().find(with_clouds)).collect();
        match found.as_slice() {
            [] => {}
            [only] => return read_folder(path, only).map(Some),
            several => return Err(several_folders(path, several)),
        }
    }
    let parts: Vec<PathBuf> = NUSCENES.iter().map(|part| path.join(part)).filter(|part| part.is_dir()).collect();
    if !parts.is_empty() {
        return nuscenes(path, &parts).map(Some);
    }
    let clouds = select_clouds(&entries);
    if clouds.is_empty() { Ok(None) } else { assemble(path, PathBuf::new(), clouds).map(Some) }
}

/// The keyframes and sweeps of nuScenes as one sequence.
fn nuscenes(path: &Path, parts: &[PathBuf]) -> Result<CloudFolder> {
    let mut clouds = Vec::new();
    for part in parts {
        clouds.extend(cloud_files(part)?);
    }
    let relative = parts[0].strip_prefix(path).unwrap_or(&parts[0]).to_owned();
    let mut folder = assemble(path, relative, clouds)?;
    if parts.len() > 1 {
        folder.notes.push(format!("{} are taken together, in the order of time", NUSCENES.join("/ and ") + "/"));
    }
    Ok(folder)
}

/// Folders of any name with clouds, closest first: as soon as one level has some, deeper ones are not searched.
fn search(path: &Path) -> Result<Vec<PathBuf>> {
    let mut level = vec![path.to_owned()];
    let mut listed = 0;
    for _ in 0..SEARCH_DEPTH {
        let (mut found, mut next) = (Vec::new(), Vec::new());
        for folder in &level {
            // A subfolder that may not be listed is not searched.
            for subfolder in list(folder).into_iter().flatten().filter(|e| e.is_dir()) {
                listed += 1;
                if listed > MOST_FOLDERS {
                    return Ok(found);
                }
                let clouds = cloud_files(&subfolder).map_or(0, |clouds| clouds.len());
                if clouds >= FEWEST_CLOUDS {
                    found.push(subfolder);
                } else {
                    next.push(subfolder);
                }
            }
        }
        if !found.is_empty() || next.is_empty() {
            return Ok(found);
        }
        level = next;
    }
    Ok(Vec::new())
}

/// The clouds of one folder below `path`.
fn read_folder(path: &Path, folder: &Path) -> Result<CloudFolder> {
    let relative = folder.strip_prefix(path).unwrap_or(folder).to_owned();
    assemble(path, relative, cloud_files(folder)?)
}

fn assemble(path: &Path, relative: PathBuf, files: Vec<(CloudFormat, PathBuf)>) -> Result<CloudFolder> {
    let (format, paths, note) = of_one_format(&path.join(&relative), files)?;
    Ok(CloudFolder { relative, format, clouds: in_order(paths), notes: note.into_iter().collect() })
}

fn several_folders(path: &Path, folders: &[PathBuf]) -> Error {
    let name = |folder: &PathBuf| folder.strip_prefix(path).unwrap_or(folder).display().to_string();
    let mut names = folders.iter().take(MOST_CHOICES).map(name).collect::<Vec<_>>().join(", ");
    if folders.len() > MOST_CHOICES {
        names.push_str(&format!(" and {} more", folders.len() - MOST_CHOICES));
    }
    Error::dataset(path, format!("several folders hold clouds: {names}"), "name one of them, or move the others elsewhere")
}
