//! The scans: a simulated campus, and real ones where they are found.

use crate::error::{BenchError, Result};
use crate::workshop::{Workshop, words};
use std::path::{Path, PathBuf};
use voxelastic_io::dataset::OpenOptions;
use voxelastic_io::source::{self, Source};
use voxelastic_sim::{SimOptions, Simulation};

/// What maps of the scans are measured against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Truth {
    /// The world that they were simulated in.
    World,
    /// Every so many-th scan, which is not mapped.
    HeldOut(usize),
    /// Nothing.
    None,
}

/// Scans with poses, and how they are read.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Its name in tables.
    pub name: String,
    /// The folder.
    pub folder: PathBuf,
    /// The pose file, where there are several.
    pub poses: Option<&'static str>,
    /// What its maps are measured against.
    pub truth: Truth,
    /// Scans taken of it; all when absent.
    pub max_scans: Option<usize>,
}

impl Dataset {
    /// The arguments of `voxelastic map` that name it.
    pub(crate) fn arguments(&self) -> Vec<String> {
        let mut arguments = vec![self.folder.display().to_string()];
        arguments.extend(self.poses.iter().flat_map(|poses| words(&["--poses", poses])));
        if let Truth::HeldOut(every) = self.truth {
            arguments.extend(words(&["--hold-out", &every.to_string()]));
        }
        arguments.extend(self.max_scans.iter().flat_map(|most| words(&["--max-scans", &most.to_string()])));
        arguments
    }

    /// The scans as [`arguments`](Self::arguments) make `voxelastic map` take them.
    pub(crate) fn open(&self) -> Result<Source> {
        let mut source = source::open(&self.folder, &OpenOptions { poses: self.poses.map(PathBuf::from), ..OpenOptions::default() })?;
        if let Some(most) = self.max_scans {
            source.limit(most);
        }
        if let Truth::HeldOut(every) = self.truth {
            source.retain(move |i| i % every != every - 1);
        }
        Ok(source)
    }
}

/// A simulated folder below the workshop's, made unless the same is there already.
pub(crate) fn simulated(shop: &Workshop, name: &str, arguments: &[&str]) -> Result<PathBuf> {
    let folder = shop.folder().join(name);
    let wanted = shop.folder().join(format!("{name}.options"));
    let told = arguments.join(" ");
    let is_made = Simulation::load(&folder).is_ok() && std::fs::read_to_string(&wanted).is_ok_and(|made| made == told);
    if !is_made {
        tracing::info!("simulating {name}");
        let mut all = words(&["simulate"]);
        all.extend(words(arguments));
        all.extend([String::from("--json"), String::from("-o"), folder.display().to_string()]);
        shop.ask(&all)?;
        std::fs::write(&wanted, told).map_err(BenchError::file(&wanted))?;
    }
    Ok(folder)
}

/// The campus of the figures: 210 scans, 2 m apart, of a 64 x 1024 sensor. `folder` is one that was simulated before.
pub(crate) fn campus(shop: &Workshop, folder: Option<&Path>) -> Result<Dataset> {
    let folder = match folder {
        Some(folder) if !Simulation::load(folder).is_ok_and(|s| *s.options() == SimOptions::of("campus")) => {
            return Err(BenchError::Campus { path: folder.to_path_buf() });
        }
        Some(folder) => folder.to_path_buf(),
        None => simulated(shop, "campus", &["campus"])?,
    };
    Ok(Dataset { name: "campus".to_owned(), folder, poses: Some("groundtruth"), truth: Truth::World, max_scans: None })
}

/// The real scans that are found in `data`, and what to say of the others.
pub(crate) fn real(data: &Path) -> (Vec<Dataset>, Vec<String>) {
    let hall = Dataset { name: "hall".to_owned(), folder: data.join("hall"), poses: None, truth: Truth::HeldOut(10), max_scans: None };
    let street =
        Dataset { name: "street".to_owned(), folder: data.join("kitti00-street"), poses: Some("groundtruth"), truth: Truth::None, max_scans: None };
    let (found, missing): (Vec<_>, Vec<_>) = [hall, street].into_iter().partition(|d| d.folder.is_dir());
    let skipped = missing.iter().map(|d| format!("skipped: {}: no folder {} (VOXELASTIC_DATA names the one above it)", d.name, d.folder.display()));
    (found, skipped.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn real_data_that_is_missing_is_told() {
        let (found, skipped) = real(Path::new("/no/such/folder"));
        assert!(found.is_empty() && skipped.len() == 2);
        assert!(skipped.iter().all(|s| s.starts_with("skipped: ") && s.contains("VOXELASTIC_DATA")));
    }

    #[test]
    fn a_dataset_says_how_it_is_mapped() {
        let hall = Dataset { name: "hall".into(), folder: "x".into(), poses: Some("a"), truth: Truth::HeldOut(10), max_scans: Some(5) };
        assert_eq!(hall.arguments().join(" "), "x --poses a --hold-out 10 --max-scans 5");
    }
}
