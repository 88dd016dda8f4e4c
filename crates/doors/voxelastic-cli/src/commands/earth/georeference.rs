//! `voxelastic georeference`: puts a map on Earth.

use super::table;
use crate::failure::{self, Failure};
use crate::output;
use clap::{ArgGroup, Args};
use nalgebra::Vector3;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_earth::{Georeference, Heights, written};
use voxelastic_run::georeference::{self, Clock, Outcome, Request, Row, Statistics, Use};
use voxelastic_run::{Warning, Warnings, map_files};

/// Put a map on Earth
///
/// Finds where the map lies from fixes of a receiver, or from control points, robustly, and stores that with the map: its frame stays. Unless --rigid is given, the
/// map is then bent: poses follow the fixes as their standard deviations say, fixes that contradict all else are refused, and submaps move with the poses; no scan is
/// mapped again. Clouds (LAS, LAZ, COPC) are then written in the coordinate system, tiles with a place on the globe.
///
/// Fixes are an NMEA log, a solution of RTKLIB (.pos), a table (CSV; or numbers: time x y z, with three standard deviations or a quaternion), `oxts` of a KITTI raw drive,
/// or a recording with sensor_msgs/NavSatFix, gps_common/GPSFix, nmea_msgs/Sentence, or nav_msgs/Odometry in metres. Control points are a table with name, coordinates,
/// sigma, and where they were seen: map_x, map_y, map_z, or the time at which the sensor stood there.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("fixes").required(true).args(["gnss", "control", "show"]), after_help = "Examples:
  voxelastic georeference drive.vox --gnss drive.nmea --crs utm
  voxelastic georeference drive.vox --gnss drive.mcap --crs EPSG:25832 --lever 0.1,0,0.3
  voxelastic georeference hall.vox --control points.csv --crs EPSG:25832 --rigid
  voxelastic georeference drive.vox --show --trajectory drive.gpx
  voxelastic export drive.vox -o drive.laz                          in the system that was named")]
pub struct GeoreferenceArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// Fixes of a receiver
    #[arg(long, value_name = "FILE|FOLDER")]
    gnss: Option<PathBuf>,
    /// Control points
    #[arg(long, value_name = "FILE.csv")]
    control: Option<PathBuf>,
    /// Change nothing: say where the map is
    #[arg(long)]
    show: bool,
    /// Topic of a recording
    #[arg(long, value_name = "TOPIC", requires = "gnss")]
    gnss_topic: Option<String>,
    /// Coordinate system of fixes in metres, and of what is exported: an EPSG code, or utm for the zone of the place [default: latitude and longitude in, east, north
    /// and up of the first fix out]
    #[arg(long, value_name = "EPSG:N|utm")]
    crs: Option<String>,
    /// What heights count from, where the file does not say it
    #[arg(long, value_name = "WHAT", value_parser = ["ellipsoid", "sea-level"])]
    heights: Option<String>,
    /// Move the map as a whole only
    #[arg(long)]
    rigid: bool,
    /// The antenna in the frame of the lidar, metres
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,0", value_parser = three, allow_hyphen_values = true)]
    lever: Vector3<f64>,
    /// To be added to times of fixes, seconds; auto finds it. Without it, clocks are taken for the same, and another one is said
    #[arg(long, value_name = "S|auto", value_parser = clock, allow_hyphen_values = true)]
    time_offset: Option<Clock>,
    /// Standard deviation of fixes that come without, metres [default: 0.5]
    #[arg(long, value_name = "M", value_parser = positive)]
    sigma: Option<f64>,
    /// For how long fixes stay off in the same direction, seconds [default: 60 if their standard deviations are beyond 0.3 m, else 0]
    #[arg(long, value_name = "S", value_parser = not_negative)]
    correlation: Option<f64>,
    /// Hold out every Nth fix, to check the others by
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(2..))]
    check_every: Option<u64>,
    /// Write the trajectory of the map on Earth: .gpx, .geojson or .kml
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// Print one JSON object on stdout: map, place, residuals rigid and now, each fix, ..
    #[arg(long)]
    json: bool,
}

fn three(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok().filter(|v: &f64| v.abs() < 1e3)).collect();
    numbers.filter(|n| n.len() == 3).map(|n| Vector3::new(n[0], n[1], n[2])).ok_or_else(|| "must be X,Y,Z in metres".to_owned())
}

fn clock(text: &str) -> Result<Clock, String> {
    if text == "auto" {
        return Ok(Clock::Find);
    }
    text.parse().ok().filter(|v: &f64| v.is_finite()).map(Clock::Offset).ok_or_else(|| "must be a number of seconds, or auto".to_owned())
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite()).ok_or_else(|| "must be above 0".to_owned())
}

fn not_negative(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| *v >= 0.0 && v.is_finite()).ok_or_else(|| "must be a number, 0 or more".to_owned())
}

/// Where a map is, as `--json` has it.
#[derive(Debug, Serialize)]
struct PlaceSummary {
    /// Where the plane touches the Earth: degrees, metres; null of a map that is nowhere.
    latitude: Option<f64>,
    longitude: Option<f64>,
    height_m: Option<f64>,
    heights: &'static str,
    /// The system of what is exported; null for east, north and up.
    crs: Option<String>,
    /// The map frame in the plane: x y z qx qy qz qw.
    t_plane_map: [f64; 7],
}

impl From<&Georeference> for PlaceSummary {
    fn from(place: &Georeference) -> Self {
        let anchor = place.anchor;
        Self {
            latitude: anchor.map(|p| p.latitude),
            longitude: anchor.map(|p| p.longitude),
            height_m: anchor.map(|p| p.height),
            heights: place.heights.name(),
            crs: place.crs.map(|code| format!("EPSG:{code}")),
            t_plane_map: voxelastic_run::joining::numbers(&place.t_plane_map),
        }
    }
}

/// Residuals of fixes that are used, and of those held out.
#[derive(Debug, Serialize)]
struct Residuals {
    used: Statistics,
    check: Option<Statistics>,
}

impl From<[Statistics; 2]> for Residuals {
    fn from([used, check]: [Statistics; 2]) -> Self {
        Self { used, check: Some(check).filter(|check| check.count > 0) }
    }
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    #[serde(serialize_with = "crate::output::path")]
    map: &'a Path,
    place: PlaceSummary,
    /// Fixes: used, refused, held out, of places that the map does not have.
    used: usize,
    refused: usize,
    check: usize,
    elsewhere: usize,
    /// What was added to times of fixes.
    time_offset_s: f64,
    /// Residuals with the map as a rigid whole, and with the map as it is now.
    rigid: Residuals,
    now: Residuals,
    /// Standard deviations of the rigid alignment: turns about east, north, up, degrees; place of the middle, metres.
    rigid_sigmas: [f64; 6],
    /// By how much the map was bent, at most.
    bent_m: f64,
    /// By how much residuals are larger than standard deviations say, at least 1.
    spread: f64,
    fixes: &'a [Row],
    warnings: &'a [Warning],
}

/// Runs the command.
pub fn run(args: &GeoreferenceArgs) -> anyhow::Result<u8> {
    let mut warnings = Warnings::default();
    match args.gnss.as_ref().or(args.control.as_ref()) {
        Some(file) => {
            let outcome = georeference::georeference(&args.map, &request(args, file), &mut warnings)?;
            say(args, &outcome, &warnings)?;
        }
        None => show(args)?,
    }
    if let Some(path) = &args.trajectory {
        write_trajectory(&args.map, path)?;
    }
    Ok(failure::DONE)
}

fn request(args: &GeoreferenceArgs, file: &Path) -> Request {
    Request {
        file: file.to_owned(),
        topic: args.gnss_topic.clone(),
        crs: args.crs.clone(),
        heights: args.heights.as_deref().and_then(Heights::named),
        is_rigid: args.rigid,
        lever: args.lever,
        clock: args.time_offset.unwrap_or(Clock::Same),
        sigma: args.sigma,
        correlation: args.correlation,
        check_every: args.check_every.and_then(|n| usize::try_from(n).ok()),
    }
}

fn say(args: &GeoreferenceArgs, outcome: &Outcome, warnings: &Warnings) -> anyhow::Result<()> {
    let count = |what: Use| outcome.rows.iter().filter(|row| row.r#use == what).count();
    if args.json {
        return output::print_json(&Summary {
            map: &args.map,
            place: (&outcome.place).into(),
            used: count(Use::Used),
            refused: count(Use::Refused),
            check: count(Use::Check),
            elsewhere: outcome.elsewhere,
            time_offset_s: outcome.time_offset_s,
            rigid: outcome.rigid.into(),
            now: outcome.now.into(),
            rigid_sigmas: outcome.sigmas,
            bent_m: outcome.bent_m,
            spread: outcome.spread,
            fixes: &outcome.rows,
            warnings: warnings.all(),
        });
    }
    output::print(&table::residuals(outcome))
}

fn show(args: &GeoreferenceArgs) -> anyhow::Result<()> {
    let store = map_files::open(&args.map)?;
    let Some(place) = map_files::place_of(&store)? else { return Err(nowhere(&args.map)) };
    if args.json { output::print_json(&PlaceSummary::from(&place)) } else { output::print(&table::place(&place)) }
}

fn nowhere(map: &Path) -> anyhow::Error {
    Failure::new(format!("{}: the map has no place on Earth", map.display()), "give it one with --gnss or --control").into()
}

fn write_trajectory(map: &Path, path: &Path) -> anyhow::Result<()> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let unknown = || Failure::usage(format!("{}: not a known format of trajectories on Earth", path.display()), "name a .gpx, .geojson or .kml");
    let form = written::Form::of(&extension).ok_or_else(unknown)?;
    let store = map_files::open(map)?;
    let places = georeference::trajectory(&store)?.filter(|places| !places.is_empty()).ok_or_else(|| nowhere(map))?;
    let name = map.file_stem().unwrap_or_default().to_string_lossy();
    let text = written::trajectory(form, &name, &places);
    voxelastic_files::write(path, |file| std::io::Write::write_all(file, text.as_bytes()))
        .map_err(|e| Failure::new(format!("{}: {e}", path.display()), ""))?;
    tracing::info!("wrote {}", path.display());
    Ok(())
}
