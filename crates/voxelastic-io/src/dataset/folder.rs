//! What is in a folder, without decoding any of it.

use super::names;
use crate::poses::{Kind, PoseFormat, sniff};
use crate::{CloudFormat, Error, Result};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Subfolders that hold clouds.
const CLOUD_FOLDERS: [&str; 3] = ["scans", "velodyne", "clouds"];
/// Extensions of files that may hold poses, graphs or times.
const TEXT: [&str; 7] = ["txt", "tum", "csv", "g2o", "kitti", "poses", "traj"];
/// The part of a text file that tells what it is.
const SNIFFED_BYTES: u64 = 1 << 16;

/// A cloud file.
#[derive(Clone, Debug)]
pub(super) struct CloudFile {
    pub(super) path: PathBuf,
    /// The number that its name ends with.
    pub(super) number: Option<u64>,
    /// The time that its name tells, seconds since 1970.
    pub(super) stamp: Option<f64>,
}

/// A file with poses.
#[derive(Clone, Debug)]
pub(super) struct PoseFile {
    pub(super) path: PathBuf,
    pub(super) format: PoseFormat,
}

impl PoseFile {
    /// The file's name, as shown to the user.
    pub(super) fn name(&self) -> String {
        name_of(&self.path)
    }

    /// Whether its name claims that it is the ground truth.
    pub(super) fn is_ground_truth(&self) -> bool {
        let stem = stem_of(&self.path).to_ascii_lowercase();
        let letters: String = stem.chars().filter(char::is_ascii_alphanumeric).collect();
        letters.contains("groundtruth") || stem.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == "gt" || word == "truth")
    }
}

/// Corrected poses, as known after a scan: `poses@000123.txt`.
#[derive(Clone, Debug)]
pub(super) struct Snapshot {
    /// The node after whose scan they became known.
    pub(super) after: u64,
    pub(super) file: PoseFile,
}

/// The files of a dataset.
#[derive(Debug)]
pub(super) struct Folder {
    pub(super) path: PathBuf,
    /// Where the clouds are, relative to the folder; empty for the folder itself.
    pub(super) clouds_in: PathBuf,
    pub(super) format: CloudFormat,
    /// In the order of their names, or of their times if all names tell one.
    pub(super) clouds: Vec<CloudFile>,
    /// Trajectories and graphs, in the order of their names.
    pub(super) poses: Vec<PoseFile>,
    pub(super) times: Vec<PathBuf>,
    /// In the order of their numbers.
    pub(super) snapshots: Vec<Snapshot>,
    /// What was seen and left aside.
    pub(super) notes: Vec<String>,
}

/// Lists a dataset's files and tells them apart.
pub(super) fn scan(path: &Path) -> Result<Folder> {
    let entries = list(path)?;
    let (clouds_in, format, clouds, mut notes) = find_clouds(path, &entries)?;
    let (mut poses, mut times, mut snapshots) = (Vec::new(), Vec::new(), Vec::new());
    for file in entries.iter().filter(|e| e.is_file() && has_extension(e, &TEXT)) {
        let number = stem_of(file).strip_prefix("poses@").and_then(|n| n.parse::<u64>().ok());
        match (classify(file)?, number) {
            (Some(Kind::Poses(format)), Some(after)) => snapshots.push(Snapshot { after, file: PoseFile { path: file.clone(), format } }),
            (Some(Kind::Poses(format)), None) => poses.push(PoseFile { path: file.clone(), format }),
            (Some(Kind::Times), _) if stem_of(file).to_ascii_lowercase().contains("time") => times.push(file.clone()),
            (_, Some(_)) => notes.push(format!("{} holds no poses that are known and is left aside", name_of(file))),
            _ => {}
        }
    }
    snapshots.sort_by_key(|s| s.after);
    Ok(Folder { path: path.into(), clouds_in, format, clouds, poses, times, snapshots, notes })
}

/// Tells what a text file holds by its beginning.
pub(super) fn classify(path: &Path) -> Result<Option<Kind>> {
    let mut beginning = Vec::new();
    let read = File::open(path).and_then(|f| f.take(SNIFFED_BYTES).read_to_end(&mut beginning));
    read.map_err(|e| Error::io(path, "read", e))?;
    if beginning.len() as u64 == SNIFFED_BYTES {
        // The last line may be cut.
        let end = beginning.iter().rposition(|b| *b == b'\n').unwrap_or(0);
        beginning.truncate(end);
    }
    Ok(sniff(&String::from_utf8_lossy(&beginning)))
}

/// Whether a folder holds clouds in one of the places where they are looked for.
pub(crate) fn holds_clouds(path: &Path) -> bool {
    list(path).and_then(|entries| find_clouds(path, &entries)).is_ok()
}

type Clouds = (PathBuf, CloudFormat, Vec<CloudFile>, Vec<String>);

fn find_clouds(path: &Path, entries: &[PathBuf]) -> Result<Clouds> {
    let mut found = Vec::new();
    for folder in entries.iter().filter(|e| e.is_dir()) {
        if CLOUD_FOLDERS.iter().any(|name| name_of(folder).eq_ignore_ascii_case(name)) {
            let files = cloud_files(&list(folder)?);
            if !files.is_empty() {
                found.push((PathBuf::from(name_of(folder)), files));
            }
        }
    }
    if found.len() > 1 {
        let names: Vec<String> = found.iter().map(|(name, _)| name.display().to_string()).collect();
        return Err(Error::dataset(path, format!("several folders hold clouds: {}", names.join(", ")), "move all but one elsewhere"));
    }
    let own = cloud_files(entries);
    if found.is_empty() && !own.is_empty() {
        found.push((PathBuf::new(), own));
    }
    let Some((clouds_in, files)) = found.pop() else {
        let problem = "no clouds in scans/, Scans/, velodyne/, clouds/ or the folder itself";
        return Err(Error::dataset(path, problem, "name a folder that holds .pcd, .ply or .bin clouds"));
    };
    let (format, clouds, notes) = one_format(path, files)?;
    Ok((clouds_in, format, in_order(clouds), notes))
}

/// Keeps the format that most clouds have: the others are maps and the like.
fn one_format(path: &Path, files: Vec<(CloudFormat, PathBuf)>) -> Result<(CloudFormat, Vec<PathBuf>, Vec<String>)> {
    let count = |format| files.iter().filter(|(f, _)| *f == format).count();
    let mut counts = [CloudFormat::Pcd, CloudFormat::Ply, CloudFormat::KittiBin].map(|f| (count(f), f));
    counts.sort_by_key(|(n, _)| std::cmp::Reverse(*n));
    let [(most, format), (second, other), _] = counts;
    if most == second {
        let problem = format!("as many {format} files as {other} files");
        return Err(Error::dataset(path, problem, "leave the clouds of one format in the folder"));
    }
    let mut notes = Vec::new();
    if most < files.len() {
        notes.push(format!("{} files of another format than {format} are left aside", files.len() - most));
    }
    Ok((format, files.into_iter().filter(|(f, _)| *f == format).map(|(_, p)| p).collect(), notes))
}

fn cloud_files(entries: &[PathBuf]) -> Vec<(CloudFormat, PathBuf)> {
    entries.iter().filter_map(|e| CloudFormat::of(e).filter(|f| f.holds_scans()).map(|f| (f, e.clone()))).filter(|(_, e)| e.is_file()).collect()
}

fn in_order(mut paths: Vec<PathBuf>) -> Vec<CloudFile> {
    paths.sort_by(|a, b| names::natural(&stem_of(a), &stem_of(b)));
    let file = |path: PathBuf| {
        let stem = stem_of(&path);
        CloudFile { number: names::number(&stem), stamp: names::stamp(&stem), path }
    };
    let mut clouds: Vec<CloudFile> = paths.into_iter().map(file).collect();
    if clouds.iter().all(|c| c.stamp.is_some()) {
        clouds.sort_by(|a, b| a.stamp.unwrap_or(0.0).total_cmp(&b.stamp.unwrap_or(0.0)));
    } else {
        clouds.iter_mut().for_each(|c| c.stamp = None);
    }
    clouds
}

/// The entries of a folder in the order of their names, without hidden ones.
fn list(path: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io(path, "list", e);
    let entries = fs::read_dir(path).map_err(fail)?.map(|e| e.map(|e| e.path()));
    let mut entries = entries.collect::<std::io::Result<Vec<PathBuf>>>().map_err(fail)?;
    entries.retain(|e| !name_of(e).starts_with('.'));
    entries.sort();
    Ok(entries)
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().and_then(OsStr::to_str).is_some_and(|e| extensions.iter().any(|x| e.eq_ignore_ascii_case(x)))
}

pub(super) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

pub(super) fn stem_of(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}
