//! Which of the files that hold poses are meant.

use super::folder::{Folder, PoseFile, classify, stem_of};
use crate::poses::{Kind, PoseFormat};
use crate::{Error, Result};
use std::path::Path;

/// The pose file to use: the one that is asked for, or the only one that can be meant.
///
/// A graph counts only if there is no trajectory. A file called `poses` stands its ground against files that call themselves
/// ground truth; nothing else is preferred to anything else.
pub(super) fn poses(folder: &Folder, asked: Option<&Path>) -> Result<PoseFile> {
    if let Some(asked) = asked {
        return resolve(folder, asked, "pose files", "--poses", |_| true);
    }
    let trajectories: Vec<&PoseFile> = folder.poses.iter().filter(|p| p.format != PoseFormat::G2o).collect();
    let claimed: Vec<&PoseFile> = trajectories.iter().copied().filter(|p| !p.is_ground_truth()).collect();
    let graphs = folder.poses.len() - trajectories.len();
    match (trajectories.as_slice(), claimed.as_slice(), graphs) {
        ([], _, 0) => Err(Error::dataset(
            &folder.path,
            "no poses",
            "add a trajectory (TUM, KITTI rows, registered_poses.csv) or a g2o graph, or name one elsewhere with --poses",
        )),
        ([], _, 1) => Ok(folder.poses[0].clone()),
        ([one], [_], _) | ([one], [], 0) => Ok((*one).clone()),
        (_, [one], _) if stem_of(&one.path).eq_ignore_ascii_case("poses") => Ok((*one).clone()),
        _ => Err(ambiguous(folder, "pose files", "--poses", folder.poses.iter())),
    }
}

/// The pose file to hold others against: the one that is asked for, or the only one that calls itself ground truth; none if none does.
pub(super) fn truth(folder: &Folder, asked: Option<&Path>) -> Result<Option<PoseFile>> {
    if let Some(asked) = asked {
        return resolve(folder, asked, "pose files", "--poses", |_| true).map(Some);
    }
    let claim: Vec<&PoseFile> = folder.poses.iter().filter(|p| p.is_ground_truth()).collect();
    match claim.as_slice() {
        [] => Ok(None),
        [one] => Ok(Some((*one).clone())),
        several => Err(ambiguous(folder, "ground truth files", "--poses", several.iter().copied())),
    }
}

/// The pose graph to take edges from: the one that is asked for, the one that the poses are from, or the only one.
pub(super) fn graph(folder: &Folder, asked: Option<&Path>, poses: &PoseFile) -> Result<Option<PoseFile>> {
    let is_graph = |p: &PoseFile| p.format == PoseFormat::G2o;
    if let Some(asked) = asked {
        let file = resolve(folder, asked, "pose graphs", "--graph", is_graph)?;
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
fn resolve(folder: &Folder, asked: &Path, what: &'static str, flag: &'static str, fits: impl Fn(&PoseFile) -> bool) -> Result<PoseFile> {
    let inside = folder.path.join(asked);
    // A bare name means the dataset's own file; a path means what it means to the shell.
    let is_bare = asked.components().count() == 1;
    let candidates = if is_bare { [inside.as_path(), asked] } else { [asked, inside.as_path()] };
    if let Some(path) = candidates.into_iter().find(|p| p.is_file()) {
        let Some(Kind::Poses(format)) = classify(path)? else {
            let remedy = "name a file of TUM, KITTI rows, sec,nsec,x,y,z,qx,qy,qz,qw or g2o";
            return Err(Error::dataset(path, "holds no poses that are known", remedy));
        };
        return Ok(PoseFile { path: path.into(), format });
    }
    let choices: Vec<&PoseFile> = folder.poses.iter().filter(|p| fits(p)).collect();
    let part = letters(&asked.to_string_lossy());
    let whole: Vec<&PoseFile> = choices.iter().copied().filter(|p| letters(&stem_of(&p.path)) == part).collect();
    let partial: Vec<&PoseFile> = choices.iter().copied().filter(|p| !part.is_empty() && letters(&stem_of(&p.path)).contains(&part)).collect();
    match (whole.as_slice(), partial.as_slice()) {
        ([one], _) | ([], [one]) => Ok((*one).clone()),
        ([], []) => {
            let names: Vec<String> = choices.iter().map(|p| p.name()).collect();
            let there = if names.is_empty() { "nothing else".into() } else { names.join(", ") };
            Err(Error::dataset(asked, format!("no such file, and the folder offers {there}"), format!("correct {flag}")))
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
