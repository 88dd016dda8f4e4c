//! Datasets: a simulated campus, and real scans where available.

use crate::error::{BenchError, Result};
use crate::workspace::{Workspace, words};
use std::path::{Path, PathBuf};
use voxelastic_io::dataset::OpenOptions;
use voxelastic_io::source::{self, Source};
use voxelastic_sim::{SimOptions, Simulation};

/// The reference of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// The simulated world.
    World,
    /// Every n-th scan, which is not mapped.
    HeldOut(usize),
    /// No reference.
    None,
}

/// Scans with poses, and how to read them.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Its name in tables.
    pub name: String,
    /// The folder.
    pub folder: PathBuf,
    /// Name of the pose file if there are several.
    pub poses: Option<&'static str>,
    /// The reference of its maps.
    pub truth: Truth,
    /// Most scans to use; all when absent.
    pub max_scans: Option<usize>,
}

impl Dataset {
    /// A simulated folder with true poses and no reference.
    pub(crate) fn simulated(name: &str, folder: PathBuf) -> Self {
        Self { name: name.to_owned(), folder, poses: Some("groundtruth"), truth: Truth::None, max_scans: None }
    }

    /// The arguments of `voxelastic map` for this dataset.
    pub(crate) fn arguments(&self) -> Vec<String> {
        let mut arguments = vec![self.folder.display().to_string()];
        arguments.extend(self.poses.iter().flat_map(|poses| words(&["--poses", poses])));
        if let Truth::HeldOut(n) = self.truth {
            arguments.extend(words(&["--hold-out", &n.to_string()]));
        }
        arguments.extend(self.max_scans.iter().flat_map(|limit| words(&["--max-scans", &limit.to_string()])));
        arguments
    }

    /// The scans that `voxelastic map` uses with [`arguments`](Self::arguments).
    pub(crate) fn open(&self) -> Result<Source> {
        let mut source = source::open(&self.folder, &OpenOptions { poses: self.poses.map(PathBuf::from), ..OpenOptions::default() })?;
        if let Some(limit) = self.max_scans {
            source.limit(limit);
        }
        if let Truth::HeldOut(n) = self.truth {
            source.retain(move |i| i % n != n - 1);
        }
        Ok(source)
    }
}

/// A simulated folder in the workspace, created unless one with the same options exists.
pub(crate) fn simulated(workspace: &Workspace, name: &str, arguments: &[&str]) -> Result<PathBuf> {
    let folder = workspace.folder().join(name);
    let options_file = workspace.folder().join(format!("{name}.options"));
    let options = arguments.join(" ");
    let is_made = Simulation::load(&folder).is_ok() && std::fs::read_to_string(&options_file).is_ok_and(|made| made == options);
    if !is_made {
        tracing::info!("simulating {name}");
        let mut all = words(&["simulate"]);
        all.extend(words(arguments));
        all.extend([String::from("--json"), String::from("-o"), folder.display().to_string()]);
        workspace.run_json(&all)?;
        std::fs::write(&options_file, options).map_err(BenchError::file(&options_file))?;
    }
    Ok(folder)
}

/// The default campus: 210 scans, 2 m apart, of a 64 x 1024 sensor. `folder` is an existing one.
pub(crate) fn campus(workspace: &Workspace, folder: Option<&Path>) -> Result<Dataset> {
    let folder = match folder {
        Some(folder) if !Simulation::load(folder).is_ok_and(|s| *s.options() == SimOptions::of("campus")) => {
            return Err(BenchError::Campus { path: folder.to_path_buf() });
        }
        Some(folder) => folder.to_path_buf(),
        None => simulated(workspace, "campus", &["campus"])?,
    };
    Ok(Dataset { name: "campus".to_owned(), folder, poses: Some("groundtruth"), truth: Truth::World, max_scans: None })
}

/// The real datasets found in `data`, and messages about the others.
pub(crate) fn real(data: &Path) -> (Vec<Dataset>, Vec<String>) {
    let hall = Dataset { name: "hall".to_owned(), folder: data.join("hall"), poses: None, truth: Truth::HeldOut(10), max_scans: None };
    let street =
        Dataset { name: "street".to_owned(), folder: data.join("kitti00-street"), poses: Some("groundtruth"), truth: Truth::None, max_scans: None };
    let (found, missing): (Vec<_>, Vec<_>) = [hall, street].into_iter().partition(|d| d.folder.is_dir());
    (found, missing.iter().map(|d| missing_folder(&d.name, &d.folder)).collect())
}

/// What is said of a dataset that is not there.
pub(crate) fn missing_folder(name: &str, folder: &Path) -> String {
    format!("skipped: {name}: no folder {} (VOXELASTIC_DATA names the one above it)", folder.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_real_data_is_reported() {
        let (found, skipped) = real(Path::new("/no/such/folder"));
        assert!(found.is_empty() && skipped.len() == 2);
        assert!(skipped.iter().all(|s| s.starts_with("skipped: ") && s.contains("VOXELASTIC_DATA")));
    }

    #[test]
    fn dataset_arguments() {
        let hall = Dataset { name: "hall".into(), folder: "x".into(), poses: Some("a"), truth: Truth::HeldOut(10), max_scans: Some(5) };
        assert_eq!(hall.arguments().join(" "), "x --poses a --hold-out 10 --max-scans 5");
    }
}
