//! Occupancy as an OctoMap.

use crate::map_files::LoadedMap;
use crate::{Error, Result};
use std::path::Path;
use voxelastic::atlas::{Atlas, Submap, SubmapScan};
use voxelastic::query::{AtlasQuery, Resampling};
use voxelastic::settings::Settings;
use voxelastic_io::octomap;

/// How far an OctoMap reaches from its centre, voxels.
pub const REACH: u32 = 1 << 15;

/// What is written.
pub struct Occupancy<'a> {
    /// The submaps.
    pub atlas: &'a Atlas,
    /// The settings of the map.
    pub settings: &'a Settings,
    /// The name of the map, for messages.
    pub map: &'a Path,
    /// Edge of the voxels, metres; `None`: the finest of the map.
    pub voxel: Option<f64>,
    /// States only (`.bt`), or log-odds (`.ot`).
    pub states_only: bool,
}

impl<'a> Occupancy<'a> {
    /// That of a map that was loaded from `map`.
    pub fn of(loaded: &'a LoadedMap, map: &'a Path, voxel: Option<f64>, states_only: bool) -> Self {
        Self { atlas: &loaded.atlas, settings: &loaded.settings, map, voxel, states_only }
    }
}

/// What was written.
#[derive(Clone, Copy, Debug)]
pub struct Written {
    /// Edge of the voxels, metres.
    pub voxel: f64,
    /// Cubes.
    pub leaves: usize,
    /// Those of them that are occupied.
    pub occupied_leaves: usize,
}

/// Writes the file. Its coordinates count from the origin of the map. To be called in a pool.
///
/// # Errors
/// A map without occupancy, voxels finer than those of the map, a map that reaches farther than an OctoMap can, or a file that cannot be written.
pub fn write(path: &Path, what: &Occupancy<'_>) -> Result<Written> {
    let (query, map) = (AtlasQuery::new(what.atlas), what.map.display());
    if query.is_empty() {
        let remedy = "map the data again with --field occupancy or --field both";
        return Err(Error::new(format!("{map}: the map has no occupancy"), remedy));
    }
    // The setting as a decimal number: 0.065 and not its nearest single-precision number.
    let finest: f64 = what.settings.voxel_size.to_string().parse().unwrap_or_else(|_| query.voxel_size());
    let voxel = what.voxel.unwrap_or(finest);
    if voxel < 0.99 * finest {
        let message = format!("the finest voxel of the map is {finest} m, but voxels of {voxel} m are asked for");
        return Err(Error::usage(message, "choose a larger --voxel-size, or map the data again with a smaller one"));
    }
    refuse_if_far(what.atlas, what.map, voxel)?;
    let cubes = query.resample(&Resampling { voxel, states_only: what.states_only });
    if cubes.is_empty() {
        let message = format!("{map}: nothing of the map is near enough to its origin for an OctoMap, which reaches {REACH} voxels from it");
        return Err(Error::new(message, "map the data again, which gives the map an origin near its first pose, or use a larger --voxel-size"));
    }
    let write = if what.states_only { octomap::write_bt } else { octomap::write_ot };
    write(path, voxel, &cubes)?;
    Ok(Written { voxel, leaves: cubes.len(), occupied_leaves: cubes.iter().filter(|c| c.value > 0).count() })
}

/// Where scans were taken, something was observed: a map that reaches too far is refused before much is computed.
fn refuse_if_far(atlas: &Atlas, map: &Path, voxel: f64) -> Result<()> {
    let distance = |submap: &Submap, scan: &SubmapScan| (submap.t_map_submap() * scan.t_submap_lidar).translation.vector.amax();
    let farthest = atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(move |scan| distance(submap, scan))).fold(0.0, f64::max);
    let least = farthest / f64::from(REACH);
    if least <= voxel {
        return Ok(());
    }
    let what = format!(
        "{}: scans were taken {farthest:.0} m from the origin along an axis, and an OctoMap of {voxel} m reaches {REACH} voxels",
        map.display()
    );
    Err(Error::new(what, format!("use --voxel-size {:.2} or larger", (least * 100.0).ceil() / 100.0)))
}
