//! What is in a folder: clouds, poses, graphs, times, snapshots. No cloud is decoded.

use super::pose_file::{PoseFile, Snapshot};
use crate::folders::{CloudFolder, find_clouds, has_extension, list, name_of, stem_of};
use crate::poses::{TextContent, detect};
use crate::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Extensions of files that may hold poses, graphs or times.
const TEXT: [&str; 7] = ["txt", "tum", "csv", "g2o", "kitti", "poses", "traj"];
/// A text file is recognised by this many bytes of its beginning.
const BEGINNING_BYTES: u64 = 1 << 16;

/// The files of a dataset.
#[derive(Debug)]
pub(super) struct Folder {
    pub(super) path: PathBuf,
    /// The clouds.
    pub(super) clouds: CloudFolder,
    /// Trajectories and graphs, in the order of their names.
    pub(super) poses: Vec<PoseFile>,
    /// Files that could hold poses, with the numbers on each of their lines, but which number is what is not known.
    pub(super) perhaps_poses: Vec<(PathBuf, usize)>,
    /// Files of times.
    pub(super) times: Vec<PathBuf>,
    /// In the order of their nodes.
    pub(super) snapshots: Vec<Snapshot>,
}

/// Lists a dataset's files and recognises them.
pub(super) fn scan(path: &Path) -> Result<Folder> {
    let mut clouds = find_clouds(path)?;
    let (mut poses, mut perhaps_poses, mut times, mut snapshots) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for file in list(path)?.iter().filter(|e| e.is_file() && has_extension(e, &TEXT)) {
        let number = stem_of(file).strip_prefix("poses@").and_then(|n| n.parse::<u64>().ok());
        match (recognise(file)?, number) {
            (Some(TextContent::Poses(format)), Some(after)) => snapshots.push(Snapshot { after, file: PoseFile { path: file.clone(), format } }),
            (Some(TextContent::Poses(format)), None) => poses.push(PoseFile { path: file.clone(), format }),
            (Some(TextContent::Times), _) if stem_of(file).to_ascii_lowercase().contains("time") => times.push(file.clone()),
            (Some(TextContent::PerhapsPoses(columns)), None) => perhaps_poses.push((file.clone(), columns)),
            (_, Some(_)) => clouds.notes.push(format!("{} is ignored: it is not in a known pose format", name_of(file))),
            _ => {}
        }
    }
    snapshots.sort_by_key(|s| s.after);
    Ok(Folder { path: path.into(), clouds, poses, perhaps_poses, times, snapshots })
}

/// Recognises a text file by its beginning.
pub(super) fn recognise(path: &Path) -> Result<Option<TextContent>> {
    let mut beginning = Vec::new();
    let read = File::open(path).and_then(|f| f.take(BEGINNING_BYTES).read_to_end(&mut beginning));
    read.map_err(|e| Error::io(path, "read", e))?;
    if beginning.len() as u64 == BEGINNING_BYTES {
        // The last line may be cut.
        let end = beginning.iter().rposition(|b| *b == b'\n').unwrap_or(0);
        beginning.truncate(end);
    }
    Ok(detect(&String::from_utf8_lossy(&beginning)))
}
