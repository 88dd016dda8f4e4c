//! The floor as 2-D maps for robots, one for each storey.

use crate::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, DistanceQuery};
use voxelastic_ground::{Body, Cells, Grid, Ground, GroundError, Known, Storey};
use voxelastic_io::Origin;
use voxelastic_io::raster::Raster;
use voxelastic_io::raster::map_server::{self, Mode, UNKNOWN};

/// What is written.
#[derive(Clone, Copy, Debug, Default)]
pub struct GridOptions {
    /// Edge of a cell, metres; `None`: the finest voxel of the map.
    pub resolution: Option<f64>,
    /// The robot.
    pub body: Body,
    /// How states and costs become pixels.
    pub mode: Mode,
}

/// What was written, which is also the content of the file of JSON beside the maps.
#[derive(Clone, Debug, Serialize)]
pub struct Written {
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// The robot.
    pub robot: RobotKeys,
    /// The storeys, from the lowest up.
    pub storeys: Vec<StoreyKeys>,
    /// Where the floor goes on from one to another.
    pub connections: Vec<ConnectionKeys>,
}

/// The robot, as JSON.
#[derive(Clone, Copy, Debug, Serialize)]
#[allow(missing_docs)]
pub struct RobotKeys {
    pub height_m: f64,
    pub step_m: f64,
    pub slope_deg: f64,
}

/// A storey, as JSON.
#[derive(Clone, Debug, Serialize)]
pub struct StoreyKeys {
    /// Name of its map in the same folder.
    pub file: String,
    /// Median height of its floor, metres.
    pub height_m: f64,
    /// Lowest and highest floor, metres.
    pub from_m: f64,
    /// See `from_m`.
    pub to_m: f64,
    /// Cells by state.
    pub free: usize,
    /// See `free`.
    pub occupied: usize,
    /// See `free`.
    pub unknown: usize,
}

/// A connection, as JSON.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ConnectionKeys {
    /// The storeys, by number.
    pub storeys: [usize; 2],
    /// Its middle, map frame, metres.
    pub at: [f64; 3],
    /// Its width, metres.
    pub width_m: f64,
    /// Its largest step, metres.
    pub step_m: f64,
}

/// What is said of a map without surfaces.
pub const NO_SURFACES: &str = "the map has no surfaces, so a floor may seem to go on for half a metre beyond an edge that falls away: map with --field both where there are platforms, stairs or kerbs";

/// The ground of a map for a robot; of one without surfaces it warns. To be called in a pool.
///
/// # Errors
/// As [`Ground::of`], with the name of the map.
pub fn ground_of(atlas: &Atlas, map: &Path, resolution: Option<f64>, body: &Body) -> Result<Ground> {
    if DistanceQuery::new(atlas).is_empty() && !AtlasQuery::new(atlas).is_empty() {
        tracing::warn!("{}: {NO_SURFACES}", map.display());
    }
    // The setting as a decimal number: 0.065 and not its nearest single-precision number.
    let finest = atlas.voxel_size().to_string().parse().unwrap_or_else(|_| f64::from(atlas.voxel_size()));
    Ground::of(atlas, resolution.unwrap_or(finest), body).map_err(|error| {
        let message = format!("{}: {error}", map.display());
        match error {
            GroundError::Resolution { .. } | GroundError::Robot { .. } => Error::usage(message, error.remedy()),
            _ => Error::new(message, error.remedy()),
        }
    })
}

/// Writes the maps: `path` itself for one storey, else `map_0.yaml`, `map_1.yaml`, .. for `map.yaml`; and `map.json` with what connects them. To be called in a pool.
///
/// # Errors
/// As [`ground_of`], or a file that cannot be written.
pub fn write(path: &Path, atlas: &Atlas, origin: Origin, map: &Path, options: &GridOptions) -> Result<Written> {
    let GridOptions { resolution, body, mode } = *options;
    let ground = ground_of(atlas, map, resolution, &body)?;
    let origin = origin.coordinates();
    let storeys = ground.storeys();
    let mut keys = Vec::with_capacity(storeys.len());
    for (number, storey) in storeys.iter().enumerate() {
        let file = if storeys.len() == 1 { path.to_owned() } else { numbered(path, number) };
        let grid = ground.grid(storey);
        map_server::write(&file, &raster(&grid.cells, origin), &values(&grid), mode)?;
        keys.push(storey_keys(&file, storey, &grid, origin[2]));
    }
    let connections = ground.connections().iter().map(|c| {
        let at = [0, 1, 2].map(|k| rounded(c.at[k] + origin[k]));
        ConnectionKeys { storeys: c.storeys, at, width_m: rounded(c.width), step_m: rounded(c.step) }
    });
    let robot = RobotKeys { height_m: body.height, step_m: body.step, slope_deg: rounded(body.slope.to_degrees()) };
    let written = Written { resolution_m: ground.columns().cells().edge, robot, storeys: keys, connections: connections.collect() };
    let json = path.with_extension("json");
    let text = serde_json::to_string_pretty(&written).map_err(|error| Error::new(error.to_string(), ""))?;
    voxelastic_files::write(&json, |out| std::io::Write::write_all(out, text.as_bytes()))
        .map_err(|error| Error::new(format!("{}: {error}", json.display()), "check that the folder can be written and the disk has space"))?;
    Ok(written)
}

/// `map_3.yaml` for `map.yaml`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{stem}_{number}.yaml"))
}

/// Where a grid lies.
pub(super) fn raster(cells: &Cells, origin: [f64; 3]) -> Raster {
    let [x, y] = cells.origin();
    Raster { size: cells.size, pixel: cells.edge, origin: [decimal(x + origin[0]), decimal(y + origin[1])] }
}

/// Multiples of a decimal number without their rounding errors.
fn decimal(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// The cells as `nav_msgs/OccupancyGrid` has them.
fn values(grid: &Grid) -> Vec<i8> {
    let value = |(state, cost): (&State, &u8)| match state {
        State::Occupied => 100,
        State::Free => *cost as i8,
        State::Unknown => UNKNOWN,
    };
    grid.states.iter().zip(&grid.costs).map(value).collect()
}

fn storey_keys(file: &Path, storey: &Storey, grid: &Grid, origin: f64) -> StoreyKeys {
    let heights = storey.floor.iter().filter(|cell| cell.known == Known::Seen).map(|cell| f64::from(cell.height) + origin);
    let (from, to) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)));
    let count = |wanted: State| grid.states.iter().filter(|state| **state == wanted).count();
    StoreyKeys {
        file: file.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        height_m: rounded(storey.height + origin),
        from_m: rounded(from),
        to_m: rounded(to),
        free: count(State::Free),
        occupied: count(State::Occupied),
        unknown: count(State::Unknown),
    }
}
