//! Maps on disk: loading.

use crate::{Error, Result};
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::changes::RemovedVoxels;
use voxelastic::memory::{MemorySize, keep_arrays_in_file};
use voxelastic::settings::Settings;
use voxelastic_earth::Georeference;
use voxelastic_io::store::MapStore;
use voxelastic_io::{Error as FileError, Origin};
use voxelastic_report::RunLog;

/// A map in memory.
pub struct LoadedMap {
    /// The submaps.
    pub atlas: Atlas,
    /// Its settings.
    pub settings: Settings,
    /// Where the coordinates of the submaps are counted from. What users give and get is counted from zero.
    pub origin: Origin,
    /// Where it lies on Earth, if it was georeferenced.
    pub place: Option<Georeference>,
    /// Submaps that were left out because they are damaged.
    pub damaged: usize,
}

/// How a map is loaded.
#[derive(Clone, Copy, Debug, Default)]
pub struct Loading {
    /// Leave out submaps whose files are damaged or missing, and count them, instead of failing.
    pub skip_damaged: bool,
    /// Keep what later sessions, or laps, saw to be gone.
    pub keep_vanished: bool,
    /// Memory that the program may have.
    pub memory: MemorySize,
}

impl Loading {
    /// All of a map, as it is stored.
    pub const AS_STORED: Self = Self { skip_damaged: false, keep_vanished: true, memory: MemorySize(0) };

    /// Sets the memory budget, for what is made of the map, too.
    pub fn limit_memory(self) -> Result<()> {
        keep_arrays_in_file(true);
        self.memory.set_budget().map_err(|error| Error::new(format!("--memory: {error}"), ""))
    }
}

/// Loads a map.
pub fn load(path: &Path, args: Loading) -> Result<LoadedMap> {
    load_from(open(path)?, args)
}

/// Loads a map for its surfaces: without the occupancy of submaps that have a TSDF, unless sessions or laps tell by it what is gone.
pub fn load_surfaces(path: &Path, args: Loading) -> Result<LoadedMap> {
    let store = open(path)?;
    let compares_ages = !args.keep_vanished && store.has_ages(&settings_of(&store)?);
    load_from(if compares_ages { store } else { store.for_surfaces() }, args)
}

fn load_from(store: MapStore, args: Loading) -> Result<LoadedMap> {
    args.limit_memory()?;
    let (settings, origin) = (settings_of(&store)?, origin_of(&store)?);
    let place = place_of(&store)?;
    let (atlas, damaged) = if args.skip_damaged {
        let (atlas, found) = store.load_undamaged().map_err(damaged_whole)?;
        found.iter().for_each(|error| tracing::warn!("left out: {error}"));
        warn_of(&store, found.len());
        (atlas, found.len())
    } else {
        (store.load_atlas().map_err(|error| damaged_part(store.dir(), error))?, 0)
    };
    let atlas = if args.keep_vanished { atlas } else { newest(&store, atlas, &settings) };
    Ok(LoadedMap { atlas, settings, origin, place, damaged })
}

/// The map without what later sessions and laps saw to be gone.
fn newest(store: &MapStore, atlas: Atlas, settings: &Settings) -> Atlas {
    let (atlas, RemovedVoxels { surface, occupied }) = store.without_vanished(atlas, settings);
    if surface + occupied > 0 {
        tracing::info!(
            "{surface} surface voxels of earlier sessions or laps are left out: later ones saw free space there (--keep-vanished shows them)"
        );
    }
    atlas
}

/// Opens a map. An error says how a damaged one is repaired.
pub fn open(path: &Path) -> Result<MapStore> {
    MapStore::open(path).map_err(|error| match error {
        FileError::Damaged { .. } => damaged_whole(error),
        FileError::NotAMap { .. } if has_submap_files(path) => damaged_whole(error),
        error => error.into(),
    })
}

/// Says how many submaps of a map are left out.
pub fn warn_of(store: &MapStore, damaged: usize) {
    if damaged > 0 {
        let (all, path) = (store.manifest().submaps.len(), store.dir().display());
        tracing::warn!("{path}: {damaged} of {all} submaps are damaged and left out; `voxelastic repair {path}` takes them out of the map");
    }
}

/// An error that says what can be done about damage of one submap.
pub fn damaged_part(map: &Path, error: FileError) -> Error {
    match error {
        FileError::Damaged { .. } | FileError::Missing { .. } => {
            let remedy = format!("--skip-damaged leaves it out; `voxelastic repair {}` takes it out of the map", map.display());
            Error::new(error.to_string(), remedy)
        }
        error => error.into(),
    }
}

fn damaged_whole(error: FileError) -> Error {
    Error::new(error.to_string(), "`voxelastic repair MAP` makes the map again from the submap files that are whole")
}

/// Whether a folder has files that are named like those of submaps.
pub fn has_submap_files(dir: &Path) -> bool {
    let named = |name: &str| name.starts_with("submap-") && name.ends_with(".vxs");
    std::fs::read_dir(dir).is_ok_and(|entries| entries.flatten().any(|entry| named(&entry.file_name().to_string_lossy())))
}

/// The settings of a map. Settings that are not stored have their defaults.
pub fn settings_of(store: &MapStore) -> Result<Settings> {
    let Some(stored) = store.manifest().details.stored_settings() else {
        let remedy = "map the data again, or write the map's settings into its manifest as `voxelastic map` does";
        return Err(Error::new(format!("{}: the manifest does not contain the voxel size", store.dir().display()), remedy));
    };
    let size = store.manifest().details.settings.get("voxel_size");
    if let Some(error) = size.and_then(|size| Settings::default().set("voxel_size", size).err()) {
        // With another size, every coordinate of the map would be wrong.
        let remedy = "restore the manifest from a backup, or move it away and let `voxelastic repair` make it again";
        return Err(Error::new(format!("{}: damaged settings in manifest.json: {error}", store.dir().display()), remedy));
    }
    for error in &stored.refused {
        tracing::warn!("{}: the map has a setting that this version of voxelastic does not know: {error}", store.dir().display());
    }
    Ok(stored.settings)
}

/// The log of the run stored in a map, if it can be read. Problems are logged.
pub fn run_log(store: &MapStore) -> Option<RunLog> {
    read_run_log(store).inspect_err(|problem| tracing::warn!("{}: {}", store.dir().display(), problem.one_line())).ok()?
}

/// The log of the run of a map, if it has one.
///
/// # Errors
/// One that cannot be read.
pub fn read_run_log(store: &MapStore) -> Result<Option<RunLog>> {
    let damaged = |problem| {
        let message = format!("{}: the log of the run is damaged: {problem}", store.dir().join("run.json").display());
        Error::new(message, "restore it from a backup; or move it away: what odometry and loops measured is not known then")
    };
    store.run_log()?.map(|text| RunLog::from_json(&text).map_err(damaged)).transpose()
}

/// The origin of a map.
pub fn origin_of(store: &MapStore) -> Result<Origin> {
    store.manifest().details.origin().map_err(|words| {
        let remedy = "restore the manifest from a backup, or move it away and let `voxelastic repair` make it again";
        Error::new(format!("{}: damaged origin in manifest.json: {words:?}", store.dir().display()), remedy)
    })
}

/// The place of a map on Earth, if it has one.
///
/// # Errors
/// Damage of what is stored.
pub fn place_of(store: &MapStore) -> Result<Option<Georeference>> {
    store.manifest().details.georeference().map_err(|e| Error::new(format!("{}: {e}", store.dir().display()), e.remedy()))
}

/// Whether a folder has nothing but what was stored of a run that did not end.
pub fn is_unfinished(dir: &Path) -> bool {
    is_map(&dir.join("unfinished"))
}

/// Whether `path` is the directory of a map.
pub fn is_map(path: &Path) -> bool {
    path.join("manifest.json").is_file()
}
