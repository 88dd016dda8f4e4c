//! `voxelastic esdf`: distances to the nearest obstacle, as an array, a cloud or a picture.

mod grid;
mod write;

use crate::args::LoadArgs;
use crate::commands::space::slice::Corners;
use crate::failure::{self, Failure};
use crate::{commands, output};
use anyhow::Context;
use clap::Args;
use grid::Grid;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, DistanceQuery, UnknownAs};
use voxelastic_esdf::{Esdf, EsdfSample, EsdfSettings};
use voxelastic_run::map_files::{self, LoadedMap};
use voxelastic_run::threads;

/// Compute the Euclidean distance field of a map (ESDF): distances to the nearest obstacle, with gradients
///
/// The ending of the file decides: .npy is an array of distances (z, y, x) for NumPy, .ply a cloud of free space near obstacles with distance and gradient, .png a
/// picture of a slice. Where the map has surfaces (field tsdf or both), distances are corrected by them to a fraction of a voxel.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic esdf mine.vox -o distance.png                      a slice at the height of the sensor
  voxelastic esdf mine.vox -o distance.png --z 0.5 --to-unknown distances to what is not known to be free
  voxelastic esdf mine.vox -o distance.npy --bounds -5,-5,0,5,5,2 --spacing 0.1 --json
  voxelastic esdf mine.vox -o distance.ply --max-distance 1")]
pub struct EsdfArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    /// The file to write: an array, a cloud or a picture, by its ending
    #[arg(short, long, value_name = "FILE.npy|ply|png")]
    output: PathBuf,
    /// Largest distance, metres: what is farther gets this distance; at most 48 voxels
    #[arg(long, value_name = "M", default_value_t = 2.0, value_parser = length)]
    max_distance: f64,
    /// Measure distances to unknown space, too; needs a map with occupancy
    #[arg(long)]
    to_unknown: bool,
    /// Distance between neighbouring points, metres [default: the finest voxel; in pictures larger where the map is large]
    #[arg(long, value_name = "M", value_parser = length)]
    spacing: Option<f64>,
    /// Box to fill: two corners in the map frame, metres [default: the known space]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = commands::space::slice::corners, allow_hyphen_values = true)]
    bounds: Option<Corners>,
    /// Height of the slice of a picture in the map frame, metres [default: the median height of the sensor]
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = commands::space::slice::metres)]
    z: Option<f64>,
    /// Threads to use; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: file, points, origin, spacing, shape, largest distance, blocks, memory, seconds
    #[arg(long)]
    json: bool,
}

fn length(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.001..=1000.0).contains(v)).ok_or_else(|| "must be 0.001 to 1000 metres".to_owned())
}

/// The file formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Array,
    Cloud,
    Picture,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    /// Points in the file.
    points: usize,
    /// Coordinates of the first point, map frame.
    origin_m: [f64; 3],
    spacing_m: f64,
    /// Points along x, y and z.
    shape: [usize; 3],
    max_distance_m: f64,
    to_unknown: bool,
    /// Whether surfaces corrected the distances.
    surfaces: bool,
    blocks: usize,
    memory_mb: f64,
    /// Time to compute the field, without reading the map and sampling.
    seconds: f64,
}

/// Runs the command.
pub fn run(args: &EsdfArgs) -> anyhow::Result<u8> {
    let format = args.format()?;
    threads::pool(args.threads)?.install(|| {
        let map = map_files::load(&args.map, args.load.into())?;
        args.write(format, &map)
    })
}

impl EsdfArgs {
    fn format(&self) -> anyhow::Result<Format> {
        match self.output.extension().and_then(|ending| ending.to_str()) {
            Some("npy") => Ok(Format::Array),
            Some("ply") => Ok(Format::Cloud),
            Some("png") => Ok(Format::Picture),
            _ => {
                let message = format!("{}: the ending names no format of distances", self.output.display());
                Err(Failure::usage(message, "use .npy for an array, .ply for a cloud, or .png for a picture of a slice").into())
            }
        }
    }

    fn write(&self, format: Format, map: &LoadedMap) -> anyhow::Result<u8> {
        let (space, surfaces) = (AtlasQuery::new(&map.atlas), DistanceQuery::new(&map.atlas));
        self.check(map, &space, surfaces.is_empty())?;
        let clock = Instant::now();
        let unknown = if self.to_unknown { UnknownAs::Blocked } else { UnknownAs::Free };
        let settings = EsdfSettings { max_distance: self.max_distance, unknown };
        let refused = |error| Failure::usage(format!("{}: {error}", self.map.display()), "use a smaller --max-distance");
        let mut esdf = Esdf::new(settings, map.atlas.voxel_size()).map_err(refused)?;
        let stats = esdf.update(&map.atlas);
        let seconds = clock.elapsed().as_secs_f64();
        let query = esdf.query(&map.atlas);
        let to_surfaces = !self.to_unknown && !surfaces.is_empty();
        let sample =
            |points: &[[f64; 3]]| -> Vec<EsdfSample> { if to_surfaces { query.sample_many_to_surfaces(points) } else { query.sample_many(points) } };
        let known = if space.is_empty() { surfaces.bounds() } else { space.bounds() };
        let grid = self.grid(format, map, known)?;
        let cannot = || format!("cannot write {}", self.output.display());
        let points = match format {
            Format::Array => write::array(&self.output, &grid, sample).with_context(cannot)?,
            Format::Cloud => {
                let is_free = |points: &[[f64; 3]]| (!space.is_empty()).then(|| space.states(points));
                write::cloud(&self.output, &grid, self.max_distance, sample, is_free).with_context(cannot)?
            }
            Format::Picture => write::picture(&self.output, &grid, self.max_distance, sample, &space)?,
        };
        tracing::info!("{} blocks of distances in {seconds:.2} s; {points} points in {}", stats.blocks, self.output.display());
        if !map.origin.is_zero() && format != Format::Array {
            tracing::warn!(
                "coordinates in {} are single precision and count from the map's origin: add {} m to them",
                self.output.display(),
                map.origin
            );
        }
        if self.json {
            output::print_json(&Summary {
                file: &self.output,
                submaps_damaged: map.damaged,
                points,
                origin_m: map.origin.point_to_map(grid.origin),
                spacing_m: grid.spacing,
                shape: grid.shape,
                max_distance_m: self.max_distance,
                to_unknown: self.to_unknown,
                surfaces: to_surfaces,
                blocks: stats.blocks,
                memory_mb: esdf.bytes() as f64 / 1e6,
                seconds,
            })?;
        }
        Ok(failure::DONE)
    }

    /// Refuses maps that cannot answer.
    fn check(&self, map: &LoadedMap, space: &AtlasQuery<'_>, no_surfaces: bool) -> anyhow::Result<()> {
        let file = self.map.display();
        if space.is_empty() && no_surfaces {
            return Err(Failure::new(format!("{file}: the map is empty"), "map some scans").into());
        }
        if space.is_empty() && self.to_unknown {
            let message = format!("{file}: the map has no occupancy (its field is {}), so nothing says what is unknown", map.settings.field.name());
            return Err(Failure::new(message, "leave out --to-unknown, or map the scans with --field occupancy or --field both").into());
        }
        Ok(())
    }

    fn grid(&self, format: Format, map: &LoadedMap, known: Aabb) -> anyhow::Result<Grid> {
        let mut bounds = self.bounds.map_or(known, |corners| corners.local(map.origin));
        let voxel = f64::from(map.settings.voxel_size);
        if format == Format::Picture {
            let z = self.z.map_or_else(|| sensor_height(map), |z| z - map.origin.coordinates()[2]) as f32;
            (bounds.min[2], bounds.max[2]) = (z, z);
            let longest = f64::from(bounds.size()[0].max(bounds.size()[1]));
            let spacing = self.spacing.unwrap_or(voxel).max(longest / Grid::MOST_PIXELS);
            return Ok(Grid::new(bounds, spacing));
        }
        let grid = Grid::new(bounds, self.spacing.unwrap_or(voxel));
        if grid.points() > Grid::MOST_POINTS {
            let [x, y, z] = grid.shape;
            let message = format!("{x} x {y} x {z} points do not fit a file of distances: at most {} are written", Grid::MOST_POINTS);
            return Err(Failure::usage(message, "use a larger --spacing, or --bounds for a part of the map").into());
        }
        Ok(grid)
    }
}

/// The median height of the sensor, map frame, metres.
fn sensor_height(map: &LoadedMap) -> f64 {
    let submaps = map.atlas.submaps().iter();
    let heights = submaps.flat_map(|submap| submap.scans().iter().map(|scan| (submap.t_map_submap() * scan.t_submap_lidar).translation.z));
    let mut heights: Vec<f64> = heights.collect();
    heights.sort_by(f64::total_cmp);
    heights.get(heights.len() / 2).copied().unwrap_or_default()
}
