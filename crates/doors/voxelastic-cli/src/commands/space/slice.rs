//! `voxelastic slice`: draws a slice of a map.

use crate::args::LoadArgs;
use crate::failure::{self, Failure};
use crate::output;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic::field::occupancy::State;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, Axis, DistanceQuery, DistanceSlice, Slice, SliceRequest};
use voxelastic_eval::colour::{Ramp, Rgb};
use voxelastic_eval::grid_view::GridView;
use voxelastic_io::Origin;
use voxelastic_run::map_files::{self, LoadedMap};
use voxelastic_run::threads;

const OCCUPIED: Rgb = [20, 20, 24];
const FREE: Rgb = [255, 255, 255];
const UNKNOWN: Rgb = [176, 180, 186];
/// Largest number of pixels along a side; larger pixels are used beyond.
const MOST_PIXELS: f64 = 4000.0;

/// Draw a slice of a map: occupied black, free white, unknown grey
///
/// For maps without occupancy the signed distances of the TSDF are drawn.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic slice hall.vox --z 1.0 -o slice.png                  a floor plan one metre above the map's origin
  voxelastic slice hall.vox --z 0.2 --thickness 1.6 -o plan.png   everything up to the height of a robot of 1.6 m
  voxelastic slice hall.vox --x 3 -o section.png --pixel 0.02")]
pub struct SliceArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    load: LoadArgs,
    /// The picture to write
    #[arg(short, long, value_name = "FILE.png")]
    output: PathBuf,
    /// Slice at this height in the map frame, metres
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = metres, required_unless_present_any = ["x", "y"], conflicts_with_all = ["x", "y"])]
    z: Option<f64>,
    /// Slice at this x in the map frame, metres
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = metres, conflicts_with = "y")]
    x: Option<f64>,
    /// Slice at this y in the map frame, metres
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = metres)]
    y: Option<f64>,
    /// Thickness of the slice, metres: occupied has precedence over free, free over unknown
    #[arg(long, value_name = "M", value_parser = length)]
    thickness: Option<f64>,
    /// Edge of a pixel, metres [default: the finest voxel of the map, or larger to keep sides at 4000 pixels or less]
    #[arg(long, value_name = "M", value_parser = length)]
    pixel: Option<f64>,
    /// Part of the map to draw: two corners in the map frame, metres [default: the known space]
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = corners, allow_hyphen_values = true)]
    bounds: Option<Corners>,
    /// Threads to use; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: file, width, height, pixel_m, fractions of free, occupied and unknown
    #[arg(long)]
    json: bool,
}

/// Parses a coordinate.
pub fn metres(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| "must be a number of metres".to_owned())
}

fn length(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.001..=1000.0).contains(v)).ok_or_else(|| "must be 0.001 to 1000 metres".to_owned())
}

/// Parses two corners of a box, in any order.
pub fn corners(text: &str) -> Result<Corners, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let corners: Option<[f64; 6]> = numbers.and_then(|n| n.try_into().ok());
    let [a, b, c, d, e, f] = corners.ok_or_else(|| "must be six numbers like -5,-5,0,5,5,2".to_owned())?;
    Ok(Corners([[a, b, c], [d, e, f]]))
}

/// Two corners of a box in the map frame, in any order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corners([[f64; 3]; 2]);

impl Corners {
    /// The box with the origin of a map taken off.
    pub fn local(&self, origin: Origin) -> Aabb {
        let mut bounds = Aabb::default();
        self.0.iter().for_each(|p| bounds.add(origin.point_to_local(*p).map(|c| c as f32)));
        bounds
    }
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    file: &'a Path,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    width: usize,
    height: usize,
    pixel_m: f64,
    /// Fraction of the pixels; absent for distances.
    #[serde(skip_serializing_if = "Option::is_none")]
    free: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    occupied: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    unknown: Option<f64>,
}

/// Runs the command.
pub fn run(args: &SliceArgs) -> anyhow::Result<u8> {
    let pool = threads::pool(args.threads)?;
    pool.install(|| {
        let map = map_files::load(&args.map, args.load.into())?;
        let occupancy = AtlasQuery::new(&map.atlas);
        if !occupancy.is_empty() {
            let request = args.request(occupancy.bounds(), &map);
            return args.draw_states(&map, &request, &occupancy.slice(&request));
        }
        let tsdf = DistanceQuery::new(&map.atlas);
        if tsdf.is_empty() {
            return Err(Failure::new(format!("{}: the map is empty", args.map.display()), "map some scans").into());
        }
        let request = args.request(tsdf.bounds(), &map);
        args.draw_distances(&map, &request, &tsdf.slice(&request))
    })
}

impl SliceArgs {
    fn request(&self, known: Aabb, map: &LoadedMap) -> SliceRequest {
        let (axis, at) = match (self.x, self.y) {
            (Some(x), _) => (Axis::X, x),
            (_, Some(y)) => (Axis::Y, y),
            _ => (Axis::Z, self.z.unwrap_or_default()),
        };
        let at = map.origin.point_to_local([at; 3])[axis.frame()[2]];
        let bounds = self.bounds.map_or(known, |corners| corners.local(map.origin));
        let [u, v, _] = axis.frame();
        let longest = f64::from(bounds.size()[u].max(bounds.size()[v]));
        let pixel = self.pixel.unwrap_or_else(|| f64::from(map.settings.voxel_size)).max(longest / MOST_PIXELS);
        SliceRequest { axis, at, thickness: self.thickness.unwrap_or_default(), pixel, bounds }
    }

    fn draw_states(&self, map: &LoadedMap, request: &SliceRequest, slice: &Slice) -> anyhow::Result<u8> {
        let colour = |state: &State| match state {
            State::Occupied => OCCUPIED,
            State::Free => FREE,
            State::Unknown => UNKNOWN,
        };
        let cells: Vec<Rgb> = slice.states.iter().map(colour).collect();
        let legend = [(FREE, "free"), (OCCUPIED, "occupied"), (UNKNOWN, "unknown")].map(|(c, text)| (c, text.to_owned()));
        self.draw(map, request, [slice.width, slice.height], &cells, legend.into())?;
        let share = |state: State| Some(slice.states.iter().filter(|s| **s == state).count() as f64 / slice.states.len() as f64);
        let (free, occupied, unknown) = (share(State::Free), share(State::Occupied), share(State::Unknown));
        self.report(&Summary {
            file: &self.output,
            submaps_damaged: map.damaged,
            width: slice.width,
            height: slice.height,
            pixel_m: request.pixel,
            free,
            occupied,
            unknown,
        })
    }

    fn draw_distances(&self, map: &LoadedMap, request: &SliceRequest, slice: &DistanceSlice) -> anyhow::Result<u8> {
        let band = map.settings.truncation * map.settings.voxel_size;
        let colour = |d: f32| Ramp::Violet.at(0.5 + 0.5 * d / band);
        let cells: Vec<Rgb> = slice.distances.iter().map(|&d| if d.is_nan() { UNKNOWN } else { colour(d) }).collect();
        let marks = [-band, 0.0, band].map(|d| (colour(d), format!("{d:.2} m")));
        let key = marks.into_iter().chain([(UNKNOWN, "not stored".to_owned())]).collect();
        self.draw(map, request, [slice.width, slice.height], &cells, key)?;
        let (width, height) = (slice.width, slice.height);
        self.report(&Summary {
            file: &self.output,
            submaps_damaged: map.damaged,
            width,
            height,
            pixel_m: request.pixel,
            free: None,
            occupied: None,
            unknown: None,
        })
    }

    fn draw(&self, map: &LoadedMap, request: &SliceRequest, size: [usize; 2], cells: &[Rgb], legend: Vec<(Rgb, String)>) -> anyhow::Result<()> {
        const NAMES: [&str; 3] = ["x", "y", "z"];
        let [u, v, w] = request.axis.frame();
        let labels = [u, v].map(|k| format!("{} [m]", NAMES[k]));
        let from = map.origin.coordinates();
        let at = request.at + from[w];
        let to = if request.thickness > 0.0 { format!(" to {:.2}", at + request.thickness) } else { String::new() };
        let view = GridView {
            title: format!("{} = {at:.2}{to} m", NAMES[w]),
            labels: [&labels[0], &labels[1]],
            origin: [u, v].map(|k| f64::from(request.bounds.min[k]) + from[k]),
            pixel: request.pixel,
            size,
            cells,
            legend,
            ..GridView::default()
        };
        view.write_png(&self.output).with_context(|| format!("cannot draw {}", self.output.display()))
    }

    fn report(&self, summary: &Summary<'_>) -> anyhow::Result<u8> {
        tracing::info!("{} x {} pixels of {:.3} m in {}", summary.width, summary.height, summary.pixel_m, summary.file.display());
        if self.json {
            output::print_json(summary)?;
        }
        Ok(failure::DONE)
    }
}
