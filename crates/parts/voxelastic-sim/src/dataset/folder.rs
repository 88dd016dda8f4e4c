//! The folder of a simulation. An existing simulation is replaced when the new one is complete; any other folder is refused.

use super::{LABEL_FOLDER, RECORDING_FILE, WORLD_FILE};
use crate::SimError;
use std::fs;
use std::path::{Path, PathBuf};
use voxelastic_io::images::CAMERAS_FILE;
use voxelastic_io::imu_csv;

/// Subfolder for the new simulation, in the folder that it will replace.
const NEW: &str = ".new";

/// Content of the folder at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The new simulation; a part of it if the folder was new and the run was interrupted.
    Written,
    /// The previous simulation.
    Kept,
}

/// A folder that may be written to.
#[derive(Debug)]
pub struct Folder {
    dir: PathBuf,
    replaces: bool,
}

impl Folder {
    /// Checks that `dir` does not exist, is empty, or contains nothing but a simulation.
    ///
    /// # Errors
    /// [`SimError::NoFolder`], [`SimError::NotSimulated`], [`SimError::File`].
    pub fn claim(dir: &Path) -> Result<Self, SimError> {
        if dir.exists() && !dir.is_dir() {
            return Err(SimError::NoFolder { path: dir.to_owned() });
        }
        let found = if dir.is_dir() { entries(dir)? } else { Vec::new() };
        let replaces = !found.is_empty();
        if replaces {
            let not_ours = foreign(dir)?.or_else(|| (!dir.join(WORLD_FILE).is_file() && !only_new(&found)).then(|| found[0].clone()));
            if let Some(lost) = not_ours {
                return Err(SimError::NotSimulated { path: dir.to_owned(), lost });
            }
            let new = dir.join(NEW);
            if new.is_dir() {
                fs::remove_dir_all(&new).map_err(SimError::file(&new))?;
            }
        }
        Ok(Self { dir: dir.to_owned(), replaces })
    }

    /// The folder to write to: it does not exist or is empty.
    pub fn target(&self) -> PathBuf {
        if self.replaces { self.dir.join(NEW) } else { self.dir.clone() }
    }

    /// Replaces the previous simulation by the new one, unless that is incomplete.
    ///
    /// # Errors
    /// [`SimError::File`].
    pub fn finish(self, is_part: bool) -> Result<Outcome, SimError> {
        if !self.replaces {
            return Ok(Outcome::Written);
        }
        let new = self.target();
        if is_part {
            fs::remove_dir_all(&new).map_err(SimError::file(&new))?;
            return Ok(Outcome::Kept);
        }
        for old in entries(&self.dir)?.into_iter().filter(|path| *path != new) {
            let removed = if old.is_dir() { fs::remove_dir_all(&old) } else { fs::remove_file(&old) };
            removed.map_err(SimError::file(old))?;
        }
        for path in entries(&new)? {
            let to = self.dir.join(path.file_name().unwrap_or_default());
            fs::rename(&path, &to).map_err(SimError::file(path))?;
        }
        fs::remove_dir(&new).map_err(SimError::file(&new))?;
        Ok(Outcome::Written)
    }
}

fn entries(dir: &Path) -> Result<Vec<PathBuf>, SimError> {
    let listed = fs::read_dir(dir).and_then(|all| all.map(|e| e.map(|e| e.path())).collect::<Result<Vec<_>, _>>());
    let mut paths = listed.map_err(SimError::file(dir))?;
    paths.sort();
    Ok(paths)
}

/// Whether `found` are only remains of a simulation that was killed.
fn only_new(found: &[PathBuf]) -> bool {
    found.iter().all(|path| path.ends_with(NEW))
}

/// The first entry of `dir` that is not part of a simulation.
fn foreign(dir: &Path) -> Result<Option<PathBuf>, SimError> {
    for path in entries(dir)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let numbered = |prefix: &str, ending: &str| {
            let number = name.strip_prefix(prefix).and_then(|n| n.strip_suffix(ending));
            number.is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
        };
        let inner = match name.as_str() {
            NEW if path.is_dir() => foreign(&path)?,
            imu_csv::FOLDER if path.is_dir() => entries(&path)?.into_iter().find(|file| !is_imu(file)),
            RECORDING_FILE if path.is_file() => None,
            "images" if path.is_dir() => foreign_image(&path)?,
            "scans" if path.is_dir() => entries(&path)?.into_iter().find(|scan| !is_numbered(scan, "pcd")),
            LABEL_FOLDER if path.is_dir() => entries(&path)?.into_iter().find(|labels| !is_numbered(labels, "label")),
            "poses.tum" | "groundtruth.tum" | "graph.g2o" | WORLD_FILE if path.is_file() => None,
            _ if numbered("poses@", ".txt") && path.is_file() => None,
            _ => Some(path),
        };
        if inner.is_some() {
            return Ok(inner);
        }
    }
    Ok(None)
}

fn is_imu(path: &Path) -> bool {
    path.is_file() && (path.ends_with(imu_csv::FILE) || path.ends_with("truth.tum"))
}

/// The first thing in a folder of images that no simulation writes.
fn foreign_image(folder: &Path) -> Result<Option<PathBuf>, SimError> {
    for path in entries(folder)? {
        let found = if path.is_dir() { entries(&path)?.into_iter().find(|image| !is_image(image)) } else { None };
        if found.is_some() || (path.is_file() && !path.ends_with(CAMERAS_FILE)) {
            return Ok(found.or(Some(path)));
        }
    }
    Ok(None)
}

fn is_image(path: &Path) -> bool {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.is_file() && path.extension().is_some_and(|e| e == "png") && stem.parse::<f64>().is_ok()
}

/// Whether a file has the number of a scan for its name, and this extension.
fn is_numbered(path: &Path, extension: &str) -> bool {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.is_file() && path.extension().is_some_and(|e| e == extension) && !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn simulated() -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("scans")).unwrap();
        for name in ["scans/000000.pcd", "poses.tum", "poses@000012.txt", "groundtruth.tum", "graph.g2o", WORLD_FILE] {
            fs::write(dir.path().join(name), "old").unwrap();
        }
        dir
    }

    #[test]
    fn a_complete_simulation_replaces_another() {
        let dir = simulated();
        let folder = Folder::claim(dir.path()).unwrap();
        fs::create_dir(folder.target()).unwrap();
        fs::write(folder.target().join(WORLD_FILE), "new").unwrap();
        assert_eq!(fs::read_to_string(dir.path().join("poses.tum")).unwrap(), "old");
        assert_eq!(folder.finish(false).unwrap(), Outcome::Written);
        assert_eq!(entries(dir.path()).unwrap(), [dir.path().join(WORLD_FILE)]);
        assert_eq!(fs::read_to_string(dir.path().join(WORLD_FILE)).unwrap(), "new");
    }

    #[test]
    fn remains_of_a_killed_run_are_removed_and_nothing_else() {
        let dir = simulated();
        fs::create_dir(dir.path().join(NEW)).unwrap();
        fs::write(dir.path().join(NEW).join("poses.tum"), "half").unwrap();
        let folder = Folder::claim(dir.path()).unwrap();
        assert!(!folder.target().exists());
        fs::create_dir(folder.target()).unwrap();
        assert_eq!(folder.finish(true).unwrap(), Outcome::Kept);
        assert_eq!(entries(dir.path()).unwrap().len(), 6, "an incomplete simulation replaces nothing: five files and the scans");
        for other in ["scans/notes.txt", "scans/a.pcd", "poses@x.txt", "thesis.tex"] {
            let dir = simulated();
            fs::write(dir.path().join(other), "content").unwrap();
            let refused = Folder::claim(dir.path()).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(refused.contains(other.rsplit('/').next().unwrap()), "{refused}");
        }
        let dir = simulated();
        fs::remove_file(dir.path().join(WORLD_FILE)).unwrap();
        assert!(Folder::claim(dir.path()).is_err(), "a dataset of the user may look like this");
    }
}
