//! Maps on disk: loading.

use crate::failure::Failure;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::settings::Settings;
use voxelastic_io::store::MapStore;

/// A map in memory.
pub struct LoadedMap {
    /// The submaps.
    pub atlas: Atlas,
    /// Its settings.
    pub settings: Settings,
}

/// Loads a map.
pub fn load(path: &Path) -> anyhow::Result<LoadedMap> {
    let store = MapStore::open(path)?;
    let settings = settings_of(&store)?;
    Ok(LoadedMap { atlas: store.load_atlas()?, settings })
}

/// The settings of a map. Settings that an older version did not store have their defaults.
pub fn settings_of(store: &MapStore) -> anyhow::Result<Settings> {
    let Some(stored) = store.manifest().details.stored_settings() else {
        let remedy = "map the data again, or write the map's settings into its manifest as `voxelastic map` does";
        return Err(Failure::new(format!("{}: the manifest does not contain the voxel size", store.dir().display()), remedy).into());
    };
    for error in &stored.refused {
        tracing::warn!("{}: the map has a setting that this version of voxelastic does not know: {error}", store.dir().display());
    }
    Ok(stored.settings)
}

/// Whether `path` is the directory of a map.
pub fn is_map(path: &Path) -> bool {
    path.join("manifest.json").is_file()
}
