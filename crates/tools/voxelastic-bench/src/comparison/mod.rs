//! Everything that pip can install beside ours, on everything that is here, in one run: the page `docs/comparison.md`.
//!
//! Surfaces and free space are mapped as in [`suite`](crate::suite), at one setting each; trajectories and closures are those of [`slam`]; what moves
//! is found on labelled sweeps. A system and ours follow each other on the same scans, so that their ratio is worth more than the times.

mod moving;
mod page;

use crate::data::{self, Dataset, Truth};
use crate::error::Result;
use crate::peers::{self, Interpreters, Peer};
use crate::results::{Machine, machine};
use crate::run::{Case, Run};
use crate::setting::{HARDEST, Setting};
use crate::slam::{self, SlamBench};
use crate::workspace::{Workspace, load, words};
pub use moving::MovingRun;
pub use page::page;
use serde::Serialize;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use voxelastic::settings::FieldKind;

/// Free space at the setting that OctoMap finishes.
const COARSE: Setting = Setting { max_range: 20.0, voxel: 0.26 };
/// Time of a peer for the scans of one map, and for one trajectory, seconds.
const LIMITS: (u64, u64) = (75, 120);
/// Scans of the simulated walk, of which 30 are at rest: all, and of a quick run.
const WALK_SCANS: (usize, usize) = (230, 90);
/// Scans of the campus in a quick run.
const QUICK_CAMPUS: &[&str] = &["campus", "--scans", "60"];
/// The recordings of trajectories; the last is left out of a quick run.
const RECORDINGS: [&str; 4] = ["kitti00-seq", "campus-walk", "hall", "kitti00-loops"];
/// Scratch name of our map.
const MAP: &str = "compared.vox";

/// Systems that are asked for and that pip cannot bring, with the reason.
const NOT_TO_BE_HAD: &[(&str, &str)] = &[
    ("UFOMap", "has no package on the Python index"),
    ("Bonxai", "has no package on the Python index: `bonxai` there is a widget library"),
    ("wavemap", "has no package on the Python index: `wavemap` there is about sound"),
    ("supereight2, voxblox, nvblox", "have no package on the Python index for these versions of Python, or need a graphics card"),
    ("FreeDOM, PlanarMesh, RESPLE, GLIM, FAST-LIO", "are built from source with ROS, and have no package on the Python index that runs without"),
    ("SE3-LIO, Super-LIO", "are on the Python index, and have no adapter here yet"),
];

/// All results.
#[derive(Debug, Default, Serialize)]
pub struct Comparison {
    /// Version of this structure: 1.
    pub format: u32,
    /// What `voxelastic --version` says.
    pub program: String,
    /// Whether scans were few, and `kitti00-loops` left out.
    pub quick: bool,
    /// Whether all of it was run; else the run was stopped before.
    pub is_complete: bool,
    /// The day, year first.
    pub date: String,
    /// The machine.
    pub machine: Machine,
    /// Maps.
    pub maps: Vec<Run>,
    /// Trajectories and closures.
    pub slam: SlamBench,
    /// What moves.
    pub moving: Vec<MovingRun>,
    /// What was left out, and why.
    pub skipped: Vec<String>,
    /// Duration, seconds.
    pub total_s: f64,
}

/// Runs it all. Peers are installed below the folder of the workspace. What there is so far is given to `save` now and then, so that a run that is stopped
/// leaves it.
///
/// # Errors
/// When a program of ours fails or data cannot be read. A peer that fails is skipped and listed.
pub fn run(workspace: &Workspace, data: &Path, quick: bool, save: &mut dyn FnMut(&Comparison)) -> Result<Comparison> {
    let interpreters = Interpreters::each(workspace);
    let mut found = Comparison { format: 1, quick, program: workspace.version()?, date: today(), ..Comparison::default() };
    found.skipped.extend(NOT_TO_BE_HAD.iter().map(|(name, why)| format!("{name}: {why}")));
    let (peers, missing) = peers::python_peers(workspace, &interpreters)?;
    found.skipped.extend(missing);
    slam::install(workspace, &interpreters)?;
    // Installing is over.
    let clock = Instant::now();
    found.machine = machine();
    let mut save = |found: &mut Comparison| {
        found.machine.load_after = load();
        found.total_s = clock.elapsed().as_secs_f64();
        save(found);
    };
    found.moving = moving::run(workspace, data, &interpreters, &mut found.skipped)?;
    maps(workspace, data, &peers, &mut found, &mut save)?;
    for recording in &RECORDINGS[..if quick { RECORDINGS.len() - 1 } else { RECORDINGS.len() }] {
        let options = slam::Options {
            only: words(&[recording]),
            peers: Some(interpreters.clone()),
            limit: Duration::from_secs(LIMITS.1),
            walk_scans: if quick { WALK_SCANS.1 } else { WALK_SCANS.0 },
            keyframes_for_closures: true,
        };
        let more = slam::run(workspace, data, &options)?;
        found.slam.runs.extend(more.runs);
        // What needs an inertial unit is on one recording alone, and the page says so.
        let is_new = |why: &String, found: &Comparison| !why.contains(slam::NOT_FOR_THESE) && !found.skipped.contains(why);
        more.skipped.into_iter().for_each(|why| found.skipped.extend(is_new(&why, &found).then_some(why)));
        save(&mut found);
    }
    found.is_complete = true;
    save(&mut found);
    Ok(found)
}

/// Surfaces of three places, and free space of two of them.
fn maps(workspace: &Workspace, data: &Path, peers: &[Peer], found: &mut Comparison, save: &mut dyn FnMut(&mut Comparison)) -> Result<()> {
    let (real, missing) = data::real(data);
    found.skipped.extend(missing);
    let campus = match found.quick {
        true => Dataset { truth: Truth::World, ..Dataset::simulated("campus", data::simulated(workspace, "campus-quick", QUICK_CAMPUS)?) },
        false => data::campus(workspace, None)?,
    };
    for dataset in std::iter::once(campus).chain(real) {
        let exported = peers::export_scans(&dataset, &workspace.scratch("exported"))?;
        for (setting, field) in [(HARDEST, FieldKind::Tsdf), (COARSE, FieldKind::Occupancy)] {
            if field == FieldKind::Occupancy && dataset.truth == Truth::None {
                continue;
            }
            let case = Case { data: &dataset, setting, field, threads: 1, one_submap: false };
            found.maps.push(ours(workspace, &case)?);
            for peer in peers {
                tracing::info!("{}, {setting}, {}", dataset.name, peer.name);
                let run = peer.run(workspace, &case, &exported, Duration::from_secs(LIMITS.0))?;
                if run.note == peers::NOT_THIS_FIELD {
                    continue;
                }
                if run.scans == 0 {
                    found.skipped.push(format!("{}: {}: {}", dataset.name, peer.name, run.note));
                } else {
                    found.maps.push(run);
                }
            }
        }
        workspace.remove_scratch("exported");
        save(found);
    }
    Ok(())
}

fn ours(workspace: &Workspace, case: &Case<'_>) -> Result<Run> {
    let dataset: &Dataset = case.data;
    tracing::info!("{}, {}, {}", dataset.name, case.setting, case.field.name());
    let mut run = case.run(workspace, MAP)?;
    run.quality = case.evaluate(workspace, MAP)?;
    workspace.remove_scratch(MAP);
    Ok(run)
}

/// The day, as the system says it.
fn today() -> String {
    let said = Command::new("date").args(["-u", "+%Y-%m-%d"]).output().ok().and_then(|out| String::from_utf8(out.stdout).ok());
    said.map_or_else(|| "on an unknown day".to_owned(), |day| day.trim().to_owned())
}
