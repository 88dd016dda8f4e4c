//! `voxelastic changes`: what appeared and what vanished between two maps, or two sessions of one.

mod picture;
mod two_maps;

use crate::commands;
use crate::failure::{self, Failure};
use crate::map_files::LoadArgs;
use crate::{meshing, output};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use two_maps::TwoMaps;
use voxelastic::changes::{ChangeError, ChangeOptions, ChangedPiece, Changes, changes};
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{MeshRef, write_ply};

/// List what appeared and what vanished between two maps, or between sessions of one
///
/// A surface has appeared where the older map knows that the space was free, and vanished where the newer one does, in both cases as far around it as --margin
/// says: what only one of them saw is no change. The maps need surfaces and free space (--field both) and one frame; sessions of a map have it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic changes monday.vox tuesday.vox --picture changes.png
  voxelastic changes site.vox --appeared new.ply --vanished gone.ply   the last session of a map against those before it
  voxelastic changes site.vox --session 2 --json                       session 2 against those before it
  voxelastic changes before.vox after.vox --margin 0.4                 maps that lie up to 40 cm beside each other")]
pub struct ChangesArgs {
    /// The older map, or one with several sessions
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// The newer map [default: the last session of the first map, which is compared with those before it]
    #[arg(value_name = "NEWER.vox")]
    newer: Option<PathBuf>,
    #[command(flatten)]
    load: LoadArgs,
    /// Compare this session with those before it, instead of the last one
    #[arg(long, value_name = "N", conflicts_with = "newer")]
    session: Option<u32>,
    /// How far around a changed surface the other map must know free space only, metres: more than the two lie beside each other [default: 3 voxels, at least 0.15]
    #[arg(long, value_name = "M", value_parser = commands::slice::metres)]
    margin: Option<f64>,
    /// Smallest area of a change, square metres
    #[arg(long, value_name = "M2", default_value_t = 0.1, value_parser = commands::slice::metres)]
    least_area: f64,
    /// Write what appeared: a mesh, whose vertices are a cloud
    #[arg(long, value_name = "FILE.ply")]
    appeared: Option<PathBuf>,
    /// Write what vanished
    #[arg(long, value_name = "FILE.ply")]
    vanished: Option<PathBuf>,
    /// Draw the newer map from above: what appeared is green, what vanished red
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// Threads to use; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout: what appeared and vanished (centre, size, area), compared area, files, seconds
    #[arg(long)]
    json: bool,
}

/// One thing in `--json`.
#[derive(Debug, Serialize)]
struct Change {
    /// Middle of the box around it, map frame.
    centre_m: [f64; 3],
    /// Edges of that box.
    size_m: [f32; 3],
    area_m2: f64,
    triangles: usize,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    appeared: Vec<Change>,
    vanished: Vec<Change>,
    /// Surface of the newer map at places that the older one has observed, and all of it.
    compared_m2: f64,
    newer_m2: f64,
    margin_m: f64,
    least_area_m2: f64,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    files: Vec<&'a Path>,
    seconds: f64,
}

/// Runs the command.
pub fn run(args: &ChangesArgs) -> anyhow::Result<u8> {
    meshing::pool(args.threads)?.install(|| args.compare())
}

impl ChangesArgs {
    fn compare(&self) -> anyhow::Result<u8> {
        let clock = Instant::now();
        let maps = TwoMaps::load(&self.map, self.newer.as_deref(), self.session, self.load)?;
        let defaults = ChangeOptions::for_voxels(maps.older.voxel_size().max(maps.newer.voxel_size()));
        let options = ChangeOptions { margin: self.margin.unwrap_or(defaults.margin), least_area: self.least_area, ..defaults };
        let found = changes(&maps.older, &maps.newer, &options).map_err(|error| refused(error, &maps))?;
        for (path, pieces) in [(&self.appeared, &found.appeared), (&self.vanished, &found.vanished)] {
            if let Some(path) = path {
                write(path, pieces, maps.origin)?;
            }
        }
        if let Some(path) = &self.picture {
            picture::draw(path, &found)?;
        }
        tracing::info!(
            "{} things appeared and {} vanished between {} and {}; {:.0} of {:.0} m2 could be compared",
            found.appeared.len(),
            found.vanished.len(),
            maps.names[0],
            maps.names[1],
            found.compared_area,
            found.area
        );
        if self.json {
            output::print_json(&self.summary(&found, &options, &maps, clock.elapsed().as_secs_f64()))?;
        } else {
            print(&found, maps.origin)?;
        }
        Ok(failure::DONE)
    }

    fn summary(&self, found: &Changes, options: &ChangeOptions, maps: &TwoMaps, seconds: f64) -> Summary<'_> {
        let list = |pieces: &[ChangedPiece]| pieces.iter().map(|piece| Change::of(piece, maps.origin)).collect();
        Summary {
            appeared: list(&found.appeared),
            vanished: list(&found.vanished),
            compared_m2: found.compared_area,
            newer_m2: found.area,
            margin_m: options.margin,
            least_area_m2: options.least_area,
            submaps_damaged: maps.damaged,
            files: [&self.appeared, &self.vanished, &self.picture].into_iter().flatten().map(PathBuf::as_path).collect(),
            seconds,
        }
    }
}

impl Change {
    fn of(piece: &ChangedPiece, origin: Origin) -> Self {
        let middle = std::array::from_fn(|k| 0.5 * f64::from(piece.bounds.min[k] + piece.bounds.max[k]));
        Self { centre_m: origin.point_to_map(middle), size_m: piece.bounds.size(), area_m2: piece.area, triangles: piece.mesh.triangles.len() }
    }
}

/// Why maps cannot be compared, and what helps.
fn refused(error: ChangeError, maps: &TwoMaps) -> Failure {
    let remedy = match error {
        ChangeError::NoSurfaces(_) | ChangeError::NoOccupancy(_) => "map the scans with --field both",
        _ => "give a margin of 0 to 10 metres",
    };
    Failure::new(format!("{} and {} cannot be compared: {error}", maps.names[0], maps.names[1]), remedy)
}

/// A table for people.
fn print(found: &Changes, origin: Origin) -> anyhow::Result<()> {
    let mut text = String::new();
    for (name, pieces) in [("appeared", &found.appeared), ("vanished", &found.vanished)] {
        for piece in pieces {
            let Change { centre_m: [x, y, z], size_m: [a, b, c], area_m2, .. } = Change::of(piece, origin);
            text += &format!("{name}  at {x:.1}, {y:.1}, {z:.1} m  {a:.1} x {b:.1} x {c:.1} m  {area_m2:.1} m2\n");
        }
    }
    output::print(&text)
}

/// Writes pieces as one mesh.
fn write(path: &Path, pieces: &[ChangedPiece], origin: Origin) -> anyhow::Result<()> {
    let mesh = ChangedPiece::join(pieces);
    let file = MeshRef {
        positions: &mesh.positions,
        origin: origin.coordinates(),
        normals: &mesh.normals,
        colours: (!mesh.colours.is_empty()).then_some(&mesh.colours),
        intensity: None,
        interpolated: None,
        triangles: &mesh.triangles,
    };
    write_ply(path, &file).with_context(|| format!("cannot write {}", path.display()))
}
