//! Maps on disk: loading, and the details stored with them.

use crate::failure::Failure;
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::settings::Settings;
use voxelastic_io::store::{MapDetails, MapStore};

/// Settings that do not change the map and are not stored, so that equal maps are equal files.
const NOT_STORED: [&str; 1] = ["threads"];

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
    let stored = &store.manifest().details.settings;
    let mut settings = Settings::default();
    if !stored.contains_key("voxel_size") && !stored.contains_key("voxel") {
        let remedy = "map the data again, or write the map's settings into its manifest as `voxelastic map` does";
        return Err(Failure::new(format!("{}: the manifest does not contain the voxel size", store.dir().display()), remedy).into());
    }
    for (key, value) in stored {
        if let Err(error) = settings.set(key, value) {
            tracing::warn!("{}: the map has a setting that this version of voxelastic does not know: {error}", store.dir().display());
        }
    }
    Ok(settings)
}

/// Whether `path` is the directory of a map.
pub fn is_map(path: &Path) -> bool {
    path.join("manifest.json").is_file()
}

/// The details stored with the submaps.
pub fn details(settings: &Settings, sensor: Option<&str>) -> MapDetails {
    let stored = settings.pairs().into_iter().filter(|(key, _)| !NOT_STORED.contains(key));
    MapDetails {
        generator: concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned(),
        settings: stored.map(|(key, value)| (key.to_owned(), value)).collect(),
        sensor: sensor.map(|words| ("description".to_owned(), words.to_owned())).into_iter().collect::<BTreeMap<_, _>>(),
    }
}
