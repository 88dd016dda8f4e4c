//! `voxelastic changes`: what appeared and what vanished between two maps, or two sessions or laps of one.

mod picture;
mod two_maps;

use crate::args::LoadArgs;
use crate::commands;
use crate::failure::{self, Failure};
use crate::output;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use two_maps::{Part, TwoMaps};
use voxelastic::Pose;
use voxelastic::changes::{ChangeError, ChangeOptions, ChangedPiece, Changes, changes};
use voxelastic::geometry::Rigid;
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_run::threads;

/// List what appeared and what vanished between two maps, or between sessions or laps of one
///
/// A surface has appeared where the older map knows that the space was free, and vanished where the newer one does, in both cases as far around it as --margin
/// says: what only one of them saw is no change. The maps need surfaces and free space (--field both) and one frame; sessions of a map have it. Laps of one run are compared if
/// it was mapped with --laps apart.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic changes monday.vox tuesday.vox --picture changes.png
  voxelastic changes site.vox --appeared new.ply --vanished gone.ply   the last session of a map against those before it
  voxelastic changes site.vox --session 2 --json                       session 2 against those before it
  voxelastic changes drive.vox --picture changes.png                   each lap of a map with --laps apart against those before it
  voxelastic changes before.vox after.vox --margin 0.4                 maps that lie up to 40 cm beside each other")]
pub struct ChangesArgs {
    /// The older map, or one with several sessions or laps
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    /// The newer map [default: the last session of the first map, which is compared with those before it; of a single run, each of its laps]
    #[arg(value_name = "NEWER.vox")]
    newer: Option<PathBuf>,
    #[command(flatten)]
    load: LoadArgs,
    /// Compare this session with those before it, instead of the last one
    #[arg(long, value_name = "N", conflicts_with = "newer")]
    session: Option<u32>,
    /// Compare this lap of a run only, instead of each of them
    #[arg(long, value_name = "N", conflicts_with_all = ["newer", "session"])]
    lap: Option<u32>,
    /// How far around a changed surface the other map must know free space only, metres: more than the two lie beside each other [default: 3 voxels, at least 0.15, and more
    /// where the two are seen to fit less well]
    #[arg(long, value_name = "M", value_parser = commands::space::slice::metres)]
    margin: Option<f64>,
    /// Smallest area of a change, square metres
    #[arg(long, value_name = "M2", default_value_t = 0.1, value_parser = commands::space::slice::metres)]
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
    /// The lap in which it changed; null between maps and sessions.
    lap: Option<u32>,
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
    /// The widest margin that was taken: wider than that where the maps fit less well.
    widest_margin_m: f64,
    least_area_m2: f64,
    /// Submaps that were left out because they are damaged.
    submaps_damaged: usize,
    #[serde(serialize_with = "crate::output::paths")]
    files: Vec<&'a Path>,
    seconds: f64,
}

/// Runs the command.
pub fn run(args: &ChangesArgs) -> anyhow::Result<u8> {
    threads::pool(args.threads)?.install(|| args.compare())
}

impl ChangesArgs {
    fn compare(&self) -> anyhow::Result<u8> {
        let clock = Instant::now();
        let part = match (&self.newer, self.session, self.lap) {
            (Some(path), ..) => Part::Newer(path),
            (None, Some(number), _) => Part::Session(number),
            (None, None, Some(number)) => Part::Lap(number),
            (None, None, None) => Part::Last,
        };
        let mut all = AllChanges::default();
        TwoMaps::compare_each(&self.map, part, self.load, |maps| {
            let options = self.options(maps);
            let found = changes(&maps.older, &maps.newer, &options).map_err(|error| refused(error, maps))?;
            log(&found, maps);
            all.add(found, &options, maps);
            Ok(())
        })?;
        for (path, pieces) in [(&self.appeared, &all.found.appeared), (&self.vanished, &all.found.vanished)] {
            if let Some(path) = path {
                write(path, pieces, all.origin)?;
            }
        }
        if let Some(path) = &self.picture {
            picture::draw(path, &all.found)?;
        }
        if self.json {
            output::print_json(&self.summary(&all, clock.elapsed().as_secs_f64()))?;
        } else {
            print(&all)?;
        }
        Ok(failure::DONE)
    }

    fn options(&self, maps: &TwoMaps) -> ChangeOptions {
        let defaults = ChangeOptions::for_voxels(maps.older.voxel_size().max(maps.newer.voxel_size()));
        ChangeOptions { margin: self.margin.unwrap_or(defaults.margin), is_fitted: self.margin.is_none(), least_area: self.least_area, ..defaults }
    }

    fn summary(&self, all: &AllChanges, seconds: f64) -> Summary<'_> {
        let [appeared, vanished] = all.lists();
        Summary {
            appeared,
            vanished,
            compared_m2: all.found.compared_area,
            newer_m2: all.found.area,
            margin_m: all.margin,
            widest_margin_m: all.found.widest_margin,
            least_area_m2: self.least_area,
            submaps_damaged: all.damaged,
            files: [&self.appeared, &self.vanished, &self.picture].into_iter().flatten().map(PathBuf::as_path).collect(),
            seconds,
        }
    }
}

/// The changes of one comparison after the other.
#[derive(Default)]
struct AllChanges {
    found: Changes,
    /// The laps of what appeared and of what vanished.
    laps: [Vec<Option<u32>>; 2],
    /// What is given, or what follows from the voxels.
    margin: f64,
    origin: Origin,
    damaged: usize,
}

impl AllChanges {
    fn add(&mut self, found: Changes, options: &ChangeOptions, maps: &TwoMaps) {
        for (laps, pieces) in self.laps.iter_mut().zip([&found.appeared, &found.vanished]) {
            laps.extend(pieces.iter().map(|_| maps.lap));
        }
        let all = &mut self.found;
        all.appeared.extend(found.appeared);
        all.vanished.extend(found.vanished);
        all.compared_area += found.compared_area;
        all.area += found.area;
        all.widest_margin = all.widest_margin.max(found.widest_margin);
        all.surface.append(&found.surface, &Rigid::from(&Pose::identity()));
        (self.margin, self.origin, self.damaged) = (options.margin, maps.origin, maps.damaged);
    }

    /// What appeared, and what vanished.
    fn lists(&self) -> [Vec<Change>; 2] {
        let list = |pieces: &[ChangedPiece], laps: &[Option<u32>]| {
            pieces.iter().zip(laps).map(|(piece, lap)| Change::of(piece, self.origin, *lap)).collect()
        };
        [list(&self.found.appeared, &self.laps[0]), list(&self.found.vanished, &self.laps[1])]
    }
}

impl Change {
    fn of(piece: &ChangedPiece, origin: Origin, lap: Option<u32>) -> Self {
        let middle = std::array::from_fn(|k| 0.5 * f64::from(piece.bounds.min[k] + piece.bounds.max[k]));
        Self { lap, centre_m: origin.point_to_map(middle), size_m: piece.bounds.size(), area_m2: piece.area, triangles: piece.mesh.triangles.len() }
    }
}

fn log(found: &Changes, maps: &TwoMaps) {
    let [older, newer] = &maps.names;
    let (appeared, vanished) = (found.appeared.len(), found.vanished.len());
    tracing::info!(
        "{appeared} things appeared and {vanished} vanished between {older} and {newer}; {:.0} of {:.0} m2 could be compared",
        found.compared_area,
        found.area
    );
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
fn print(all: &AllChanges) -> anyhow::Result<()> {
    let mut text = String::new();
    for (name, list) in ["appeared", "vanished"].into_iter().zip(all.lists()) {
        for Change { lap, centre_m: [x, y, z], size_m: [a, b, c], area_m2, .. } in list {
            let lap = lap.map_or_else(String::new, |lap| format!("in lap {lap}  "));
            text += &format!("{name}  {lap}at {x:.1}, {y:.1}, {z:.1} m  {a:.1} x {b:.1} x {c:.1} m  {area_m2:.1} m2\n");
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
        triangles: &mesh.triangles,
    };
    write_ply(path, &file).with_context(|| format!("cannot write {}", path.display()))
}
