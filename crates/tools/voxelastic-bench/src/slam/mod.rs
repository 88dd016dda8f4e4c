//! Odometry and loop closures from the scans alone, beside other systems on the same scans in one run.
//!
//! Every system gets the returns of all scans of a recording, in order; errors of all are computed here, by the same code. Odometry is
//! compared on every recording that has true poses, without times, and on simulated walks with the sensor in the hand, whose points have times, with and without an
//! inertial measurement unit. On `kitti00-loops` there are closures, too: once from the scans alone, and once with the drifting
//! odometry of the data given.

mod peer;
mod results;
mod score;
mod table;

use crate::data::missing_folder;
use crate::error::Result;
use crate::peers::Interpreters;
use crate::results::{generator, machine};
use crate::workspace::{Workspace, load, words};
use peer::{Exported, SlamPeer};
use results::Recording;
use score::{Claimed, Truth};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub(crate) use peer::NOT_FOR_THESE;
pub use results::{SlamBench, SlamRun};
pub use score::{ClosureScore, PathScore};
pub use table::table;

const RECORDINGS: [Recording; 4] = [
    Recording { name: "kitti00-seq", truth: "groundtruth", odometry: None, sweeps: false },
    Recording { name: "kitti00-street", truth: "groundtruth", odometry: None, sweeps: false },
    Recording { name: "hall", truth: "poses.tum", odometry: None, sweeps: false },
    Recording { name: "kitti00-loops", truth: "groundtruth", odometry: Some("odom_poses.txt"), sweeps: false },
];

/// Simulated walks with the sensor in the hand: outdoors and through a tunnel and a doorway, and through rooms and corridors. The name of the world is
/// before the hyphen.
const WALKS: [Recording; 2] = [
    Recording { name: "campus-walk", truth: "groundtruth", odometry: None, sweeps: true },
    Recording { name: "mine-walk", truth: "groundtruth", odometry: None, sweeps: true },
];
/// How these are simulated: a minute, after three seconds at rest.
const WALK: &[&str] =
    &["--carrier", "handheld", "--rest", "3", "--moving", "--rate", "10", "--columns", "512", "--imu", "100", "--loop-radius", "0", "--scans"];

/// Voxels of the maps that are made for their closures, metres: as BENCHMARK.md has maps of `kitti00-loops`.
const MAP_VOXEL: &str = "0.4";
/// Scratch name of such a map.
const MAP: &str = "slam.vox";

/// Names of all recordings.
pub fn recordings() -> impl Iterator<Item = &'static str> {
    RECORDINGS.iter().chain(&WALKS).map(|recording| recording.name)
}

/// What is run.
#[derive(Debug)]
pub struct Options {
    /// Only the recordings of these names, if there are any.
    pub only: Vec<String>,
    /// The Python of peers, if these are wanted.
    pub peers: Option<Interpreters>,
    /// Time for a peer and a recording.
    pub limit: Duration,
    /// Scans of a simulated walk, at 10 Hz.
    pub walk_scans: usize,
    /// Where scans are keyframes metres apart, only peers that close loops: on their way there, odometry alone is lost.
    pub keyframes_for_closures: bool,
}

/// Installs the peers, so that this is not part of what is measured; whether one cannot be installed is said by [`run`].
///
/// # Errors
/// When an adapter cannot be written to the workspace.
pub(crate) fn install(workspace: &Workspace, interpreters: &Interpreters) -> Result<()> {
    peer::all(workspace, interpreters).map(drop)
}

/// Runs it.
///
/// # Errors
/// When a program of ours fails or data cannot be read. A peer that fails is skipped and listed in the results.
pub fn run(workspace: &Workspace, data: &Path, options: &Options) -> Result<SlamBench> {
    let clock = Instant::now();
    let mut bench = SlamBench { format: 1, generator: generator(), machine: machine(), ..SlamBench::default() };
    let only = &options.only;
    let (peers, missing) = options.peers.as_ref().map_or_else(|| Ok((Vec::new(), Vec::new())), |python| peer::all(workspace, python))?;
    bench.skipped.extend(missing);
    let is_wanted = |recording: &&Recording| only.is_empty() || only.iter().any(|name| name == recording.name);
    for recording in RECORDINGS.iter().filter(is_wanted) {
        let folder = data.join(recording.name);
        if !folder.is_dir() {
            bench.skipped.push(missing_folder(recording.name, &folder));
            continue;
        }
        measure(workspace, recording, &folder, (&peers, options), &mut bench)?;
    }
    for recording in WALKS.iter().filter(is_wanted) {
        let folder = workspace.scratch(recording.name);
        let world = recording.name.split('-').next().unwrap_or_default();
        tracing::info!("{}, simulation", recording.name);
        let arguments =
            [words(&["simulate", world]), words(WALK), words(&[&options.walk_scans.to_string(), "--json", "-o"]), vec![folder.display().to_string()]]
                .concat();
        workspace.run_json(&arguments)?;
        measure(workspace, recording, &folder, (&peers, options), &mut bench)?;
        workspace.remove_scratch(recording.name);
    }
    bench.machine.load_after = load();
    bench.total_s = clock.elapsed().as_secs_f64();
    Ok(bench)
}

/// Our odometry, our closures, and the peers, on a recording.
fn measure(workspace: &Workspace, recording: &Recording, folder: &Path, peers: (&[SlamPeer], &Options), bench: &mut SlamBench) -> Result<()> {
    let truth = Truth::open(folder, recording.truth)?;
    bench.runs.push(odometry(workspace, recording, folder, &truth, &[])?);
    if recording.sweeps {
        let without = odometry(workspace, recording, folder, &truth, &["--no-imu"])?;
        bench.runs.push(SlamRun { task: "odometry, no inertial unit", ..without });
    }
    if let Some(given) = recording.odometry {
        bench.runs.push(closures(workspace, recording, folder, &truth, None)?);
        bench.runs.push(closures(workspace, recording, folder, &truth, Some(given))?);
    }
    let (peers, options) = peers;
    let is_for_it = |peer: &&SlamPeer| peer.closes() || recording.odometry.is_none() || !options.keyframes_for_closures;
    if !peers.is_empty() {
        let exported = Exported::write(folder, recording, &workspace.scratch("scans"))?;
        for peer in peers.iter().filter(is_for_it) {
            tracing::info!("{}, {}", recording.name, peer.name());
            match peer.run(workspace, &exported, &truth, options.limit)? {
                Ok(run) => bench.runs.push(SlamRun { data: recording.name.to_owned(), ..run }),
                Err(why) => bench.skipped.push(format!("{}: {}: {why}", recording.name, peer.name())),
            }
        }
        workspace.remove_scratch("scans");
    }
    Ok(())
}

/// Our odometry, on one thread.
fn odometry(workspace: &Workspace, recording: &Recording, folder: &Path, truth: &Truth, more: &[&str]) -> Result<SlamRun> {
    tracing::info!("{}, odometry", recording.name);
    let poses: PathBuf = workspace.scratch("odometry.txt");
    let arguments = [
        words(&["odometry"]),
        vec![folder.display().to_string()],
        words(more),
        words(&["--threads", "1", "--json", "-o"]),
        vec![poses.display().to_string()],
    ];
    let arguments = arguments.concat();
    let answer = workspace.run_json(&arguments)?;
    let found = score::rows(&poses)?;
    Ok(SlamRun {
        system: ours(),
        data: recording.name.to_owned(),
        task: "odometry",
        scans: found.len(),
        scans_offered: truth.scans(),
        cpu_ms: answer.pointer("/cpu_ms/mean").and_then(Value::as_f64),
        peak_rss_mb: answer["peak_rss_mb"].as_f64(),
        path: truth.path(&found),
        command: Workspace::command_line(&arguments),
        ..SlamRun::default()
    })
}

/// A map with closures, from the scans alone or from odometry that is given.
fn closures(workspace: &Workspace, recording: &Recording, folder: &Path, truth: &Truth, given: Option<&str>) -> Result<SlamRun> {
    tracing::info!("{}, closures{}", recording.name, if given.is_some() { " with the odometry given" } else { "" });
    let map = workspace.scratch(MAP);
    workspace.remove_scratch(MAP);
    let way = given.map_or_else(|| words(&["--slam"]), |poses| words(&["--poses", poses, "--loops"]));
    let common = words(&["--voxel-size", MAP_VOXEL, "--threads", "1", "--json", "-o"]);
    let arguments = [words(&["map"]), vec![folder.display().to_string()], way, common, vec![map.display().to_string()]].concat();
    let answer = workspace.run_json(&arguments)?;
    let evaluated = workspace.run_json(&[
        "eval".to_owned(),
        map.display().to_string(),
        "--truth".to_owned(),
        folder.display().to_string(),
        "--poses".to_owned(),
        recording.truth.to_owned(),
        "--json".to_owned(),
    ])?;
    workspace.remove_scratch(MAP);
    let tried = answer.pointer("/closures/tried").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let claimed: Vec<Claimed> = tried.iter().filter(|c| c["verdict"] == "accepted").filter_map(Claimed::of_ours).collect();
    let ate = |what: &str| evaluated.pointer(&format!("/trajectory/ate/translation_m/{what}")).and_then(Value::as_f64);
    Ok(SlamRun {
        system: ours(),
        data: recording.name.to_owned(),
        task: if given.is_some() { "closures, odometry given" } else { "odometry and closures" },
        scans: answer.get("scans").and_then(Value::as_u64).map_or(0, |n| n as usize),
        scans_offered: truth.scans(),
        path: ate("rmse").zip(ate("mean")).map(|(rmse_m, mean_m)| PathScore { rmse_m, mean_m, ..PathScore::default() }),
        closures: Some(truth.closures(&claimed)),
        peak_rss_mb: answer["peak_rss_mb"].as_f64(),
        command: Workspace::command_line(&arguments),
        note: "the time is that of mapping, too, and not given".to_owned(),
        ..SlamRun::default()
    })
}

fn ours() -> String {
    format!("Voxelastic {}", env!("CARGO_PKG_VERSION"))
}
