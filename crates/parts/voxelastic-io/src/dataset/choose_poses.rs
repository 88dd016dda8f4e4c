//! Choosing among several pose files.

use super::folder::{Folder, recognise};
use super::pose_file::PoseFile;
use crate::folders::stem_of;
use crate::options::PoseKind;
use crate::poses::{KNOWN_FORMATS, PoseFormat, TextContent};
use crate::{Error, Result};
use std::path::Path;

/// Names, without extension, of the two trajectories that SC-A-LOAM, SC-LIO-SAM and FAST-LIO-SLAM save side by side.
const ODOMETRY: &str = "odom_poses";
const OPTIMISED: &str = "optimized_poses";

/// The chosen pose file, and why, where the choice needs a reason.
pub(super) struct ChosenPoses {
    pub(super) file: PoseFile,
    /// For the user.
    pub(super) note: Option<String>,
}

impl From<PoseFile> for ChosenPoses {
    fn from(file: PoseFile) -> Self {
        Self { file, note: None }
    }
}

/// Chooses the pose file: the requested one, or the only possible one.
///
/// - Ground truth is used only if there is nothing else.
/// - A graph's poses are used only if there is no trajectory.
/// - A file called `poses` is preferred to ground truth.
/// - Of `odom_poses` and `optimized_poses`, which are one system's estimates before and after optimisation, `kind` decides. Ground truth
///   next to them is not used.
pub(super) fn poses(folder: &Folder, requested: Option<&Path>, kind: PoseKind) -> Result<ChosenPoses> {
    if let Some(requested) = requested {
        return resolve(folder, requested, "pose files", "--poses", |_| true).map(ChosenPoses::from);
    }
    let trajectories: Vec<&PoseFile> = folder.poses.iter().filter(|p| p.format != PoseFormat::G2o).collect();
    let estimates: Vec<&PoseFile> = trajectories.iter().copied().filter(|p| !p.is_ground_truth()).collect();
    let graphs = folder.poses.len() - trajectories.len();
    if let Some(chosen) = before_or_after_optimisation(&estimates, kind) {
        return Ok(chosen);
    }
    match (trajectories.as_slice(), estimates.as_slice(), graphs) {
        ([], _, 0) => Err(none(folder)),
        ([], _, 1) => Ok(folder.poses[0].clone().into()),
        ([one], [_], _) | ([one], [], 0) => Ok((*one).clone().into()),
        (_, [one], _) if one.is_named("poses") => Ok((*one).clone().into()),
        _ => Err(ambiguous(folder, "pose files", "--poses", folder.poses.iter())),
    }
}

/// Words in the names of files of poses.
const POSE_WORDS: [&str; 8] = ["pose", "traj", "odom", "gt", "truth", "tum", "path", "slam"];

/// Without poses: an error about the file that should have some, by its name, else that there are none.
fn none(folder: &Folder) -> Error {
    let is_named_so = |path: &Path| POSE_WORDS.iter().any(|word| stem_of(path).to_ascii_lowercase().contains(word));
    match folder.perhaps_poses.iter().find(|(path, _)| is_named_so(path)) {
        Some((path, columns)) => {
            let problem = format!("{columns} numbers on each line, and which of them is what is not known");
            Error::dataset(path, problem, format!("{KNOWN_FORMATS}; or let --slam estimate the poses"))
        }
        None => Error::no_poses(
            &folder.path,
            "no poses",
            "add a trajectory (TUM, KITTI rows, registered_poses.csv) or a g2o graph, name one elsewhere with --poses, or let `voxelastic odometry` make one",
        ),
    }
}

/// The file of the requested kind, if the estimates are odometry and optimised poses of one system.
fn before_or_after_optimisation(estimates: &[&PoseFile], kind: PoseKind) -> Option<ChosenPoses> {
    let [a, b] = estimates else { return None };
    let named = |stem: &str| [a, b].into_iter().find(|file| file.is_named(stem));
    let (odometry, optimised) = (named(ODOMETRY)?, named(OPTIMISED)?);
    let (file, what, other) = match kind {
        PoseKind::Optimised => (optimised, "the optimised poses", odometry),
        PoseKind::Odometry => (odometry, "the odometry", optimised),
    };
    let note = format!("{} are {what}; {} are not used (--poses chooses)", file.name(), other.name());
    Some(ChosenPoses { file: (*file).clone(), note: Some(note) })
}

/// Chooses the file of true poses: the requested one, or the only one whose name says ground truth; `None` if there is none.
pub(super) fn truth(folder: &Folder, requested: Option<&Path>) -> Result<Option<PoseFile>> {
    if let Some(requested) = requested {
        return resolve(folder, requested, "pose files", "--poses", |_| true).map(Some);
    }
    let truths: Vec<&PoseFile> = folder.poses.iter().filter(|p| p.is_ground_truth()).collect();
    match truths.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some((*one).clone())),
        several => Err(ambiguous(folder, "ground truth files", "--poses", several.iter().copied())),
    }
}

/// Chooses the pose graph to take edges from: the requested one, the one that the poses come from, or the only one.
pub(super) fn graph(folder: &Folder, requested: Option<&Path>, poses: &PoseFile) -> Result<Option<PoseFile>> {
    let is_graph = |p: &PoseFile| p.format == PoseFormat::G2o;
    if let Some(requested) = requested {
        let file = resolve(folder, requested, "pose graphs", "--graph", is_graph)?;
        return if is_graph(&file) {
            Ok(Some(file))
        } else {
            Err(Error::dataset(&file.path, "not a g2o pose graph", "name a g2o file with --graph"))
        };
    }
    if is_graph(poses) {
        return Ok(Some(poses.clone()));
    }
    let graphs: Vec<&PoseFile> = folder.poses.iter().filter(|p| is_graph(p)).collect();
    match graphs.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some((*one).clone())),
        several => Err(ambiguous(folder, "pose graphs", "--graph", several.iter().copied())),
    }
}

/// Finds a file by its path, its name, its stem or a part of its stem that no other choice has.
fn resolve(folder: &Folder, requested: &Path, what: &'static str, flag: &'static str, fits: impl Fn(&PoseFile) -> bool) -> Result<PoseFile> {
    let inside = folder.path.join(requested);
    // A bare name means the dataset's own file; a path is relative to the current folder first, as in the shell.
    let is_bare = requested.components().count() == 1;
    let candidates = if is_bare { [inside.as_path(), requested] } else { [requested, inside.as_path()] };
    if let Some(path) = candidates.into_iter().find(|p| p.is_file()) {
        let Some(TextContent::Poses(format)) = recognise(path)? else {
            return Err(Error::dataset(path, "not in a known pose format", KNOWN_FORMATS));
        };
        return Ok(PoseFile { path: path.into(), format });
    }
    let choices: Vec<&PoseFile> = folder.poses.iter().filter(|p| fits(p)).collect();
    let part = letters(&requested.to_string_lossy());
    let whole: Vec<&PoseFile> = choices.iter().copied().filter(|p| letters(&stem_of(&p.path)) == part).collect();
    let partial: Vec<&PoseFile> = choices.iter().copied().filter(|p| !part.is_empty() && letters(&stem_of(&p.path)).contains(&part)).collect();
    match (whole.as_slice(), partial.as_slice()) {
        ([one], _) | ([], [one]) => Ok((*one).clone()),
        ([], []) => {
            let names: Vec<String> = choices.iter().map(|p| p.name()).collect();
            let available = if names.is_empty() { "nothing else".into() } else { names.join(", ") };
            Err(Error::dataset(requested, format!("no such file, and the folder offers {available}"), format!("correct {flag}")))
        }
        (several, more) => Err(ambiguous(folder, what, flag, if several.is_empty() { more.iter().copied() } else { several.iter().copied() })),
    }
}

/// Letters and digits in lower case, so that `ground-truth` finds `groundtruth_poses.txt`.
fn letters(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

fn ambiguous<'a>(folder: &Folder, what: &'static str, flag: &'static str, choices: impl Iterator<Item = &'a PoseFile>) -> Error {
    Error::Ambiguous { path: folder.path.clone(), what, flag, choices: choices.map(PoseFile::name).collect() }
}
